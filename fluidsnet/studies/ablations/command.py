"""``fluidsnet ablations``: both ablations of the paper, over scenes, time steps and seeds."""

from __future__ import annotations

import re
import signal
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import yaml
from tqdm import tqdm

from datamodules.generate.command import generate_command
from datamodules.schema import SPLITS
from fluidsnet.errors import UserError
from fluidsnet.studies.ablations.report import write_report
from fluidsnet.studies.ablations.trained_run import TrainedRun
from fluidsnet.studies.ablations.training import Training
from fluidsnet.studies.machine import cores
from fluidsnet.studies.parser import Parser, study_parser

#: Of `configs`, in the order they are composed; the scene's data come after the second.
BEFORE = ("trainer.yaml", "model/paper.yaml")
AFTER = ("study/ablations.yaml", "ablation/target.yaml", "ablation/global_feature.yaml")
#: Options of `fluidsnet fit` without a dot: whole sections, files, and what the study sets itself.
_WHOLE = re.compile(r"-[a-z]|--\w+(=|$)")
_ROOT = re.compile(r"--data\.(root|init_args|init_args\.root)(=|$)")


@dataclass(frozen=True)
class SceneRuns:
    """Trainings on one scene: each stride with each seed.

    Attributes:
        scene: a name in configs/scene and configs/data.
        strides: frames from a state to the next.
        seeds: of everything that is drawn.
    """

    scene: str
    strides: list[int]
    seeds: list[int]


def _study() -> list[SceneRuns]:
    return [
        SceneRuns("dam_break_small", [1, 8], [0, 1, 2]),
        SceneRuns("drop_pool_small", [1, 8], [0]),
        SceneRuns("cuboid_basin_small", [1, 8], [0]),
    ]


@dataclass(frozen=True)
class AblationsOptions:
    """What to train.

    Attributes:
        runs: scenes, each with its strides and seeds; those of docs/ablations.md by default.
        fit: more settings of `fluidsnet fit` for all of them, such as
            ["--trainer.max_steps=100"]; weights are kept every 100 steps.
        configs: the folder of the configs.
        jobs: trainings at once; on the CPU they share its cores. 1 where there is one GPU.
        output: folder for the runs, and for ablations.md, its CSV files and its pictures.
    """

    runs: list[SceneRuns] = field(default_factory=_study)
    fit: list[str] = field(default_factory=list)
    configs: str = "configs"
    jobs: int = 2
    output: str = "runs/ablations"

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise UserError(f"--jobs is {self.jobs}; it must be at least 1.")
        for of in self.runs:
            if not of.strides or min(of.strides) < 1 or not of.seeds:
                raise UserError(f"--runs: {of.scene} needs strides from 1 on, and seeds.")
        if not self.runs:
            raise UserError("--runs names no scene.")
        for word in self.fit:
            # A training's note does not know of files named here, and they could name other data.
            if _WHOLE.match(word):
                raise UserError(
                    f"--fit takes single settings such as --trainer.max_steps=100, not {word}; "
                    "files belong in the folder of --configs."
                )
            if _ROOT.match(word):
                raise UserError(
                    f"--fit has {word}, for all scenes; where each has its data is said in "
                    f"{self.configs}/data."
                )
        for name in (*BEFORE, *AFTER, *(f"data/{of.scene}.yaml" for of in self.runs)):
            if not (Path(self.configs) / name).is_file():
                raise UserError(f"{self.configs}/{name} is missing; --configs names the folder.")


def ablations_command(arguments: list[str]) -> None:
    """Simulates what is missing, trains and tests what is not done, and writes the report.

    Raises:
        UserError: an option cannot be used, or a training failed; the others go on.
    """
    parser = _parser()
    values = vars(parser.instantiate(parser.parse_args(arguments)))
    options = AblationsOptions(**{name: of for name, of in values.items() if name != "config"})
    trainings = _trainings(options)
    for scene in dict.fromkeys(run.scene for run in trainings):
        _generate(Path(options.configs), scene)
    failures = _train(trainings, options)
    print(f"\n{_report(trainings, options)}\n{options.output}/ablations.md holds it.")
    if failures:
        raise UserError(
            "\n".join([*failures, "When that is mended, the same command does what is left."])
        )


def _parser() -> Parser:
    return study_parser(
        "ablations",
        (
            "Trains the paper's network beside one that predicts the acceleration and one without "
            "the global feature, on several scenes, time steps and seeds, and says what that makes "
            "of the paper's claims. It simulates the data that are missing. It may be interrupted: "
            "the same command goes on where it was. The whole study takes two cores some two "
            "hours; a first try: fluidsnet ablations --fit '[--trainer.max_steps=100]' --runs "
            '\'[{"scene": "dam_break_small", "strides": [8], "seeds": [0]}]\' --output runs/try'
        ),
        AblationsOptions,
    )


def _trainings(options: AblationsOptions) -> dict[TrainedRun, Training]:
    configs = Path(options.configs)
    found: dict[TrainedRun, Training] = {}
    for of in options.runs:
        files = [configs / name for name in (*BEFORE, f"data/{of.scene}.yaml", *AFTER)]
        for seed in of.seeds:
            for stride in of.strides:
                name = Path(of.scene, f"stride_{stride}", f"seed_{seed}")
                run = TrainedRun(of.scene, stride, seed, Path(options.output) / name)
                arguments = [
                    *options.fit,
                    # Last, as the run is named for them.
                    f"--seed_everything={seed}",
                    f"--data.init_args.stride={stride}",
                ]
                threads = max(1, cores() // options.jobs)
                found[run] = Training(run.folder, files, arguments, threads)
    return found


def _generate(configs: Path, scene: str) -> None:
    """Simulates a scene whose data are missing."""
    values: Any = yaml.safe_load((configs / "data" / f"{scene}.yaml").read_text())
    root = Path(values["data"]["init_args"]["root"])
    if not all((root / f"{split}.h5").exists() for split in SPLITS):
        generate_command([f"--config={configs / 'scene' / scene}.yaml", f"--root={root}"])


def _train(trainings: dict[TrainedRun, Training], options: AblationsOptions) -> list[str]:
    """Trains several at once, and reports after each; what failed is said at the end."""
    left = [training for training in trainings.values() if not training.done]
    failures: list[str] = []
    stages = len(Training.STAGES)
    bar = tqdm(total=stages * len(trainings), desc="training and testing", unit="stage")
    bar.update(stages * (len(trainings) - len(left)))

    def both(training: Training) -> None:
        for stage in Training.STAGES:
            training.run(stage)
            bar.update()

    pool = ThreadPoolExecutor(options.jobs)
    before = signal.signal(signal.SIGTERM, _terminated)
    try:
        waiting = [pool.submit(both, training) for training in left]
        for ended in as_completed(waiting):
            error = ended.exception()
            if isinstance(error, UserError):
                failures.append(str(error))
                print(error, file=sys.stderr)
            elif error is not None:
                raise error
            else:
                _report(trainings, options)
    finally:
        # Of an interrupt the processes know only where it came from the keyboard.
        for training in left:
            training.stop()
        pool.shutdown(cancel_futures=True)
        signal.signal(signal.SIGTERM, before)
        bar.close()
    return failures


def _terminated(number: int, frame: object) -> NoReturn:
    print("fluidsnet: terminated.", file=sys.stderr)
    sys.exit(128 + number)


def _report(trainings: dict[TrainedRun, Training], options: AblationsOptions) -> str:
    done: Sequence[TrainedRun] = [run for run, training in trainings.items() if training.done]
    return write_report(Path(options.output), done, len(trainings))
