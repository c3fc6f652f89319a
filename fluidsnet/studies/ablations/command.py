"""``fluidsnet ablations``: the paper's two ablations over scenes, time steps and seeds."""

from __future__ import annotations

import re
import signal
import sys
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any, NoReturn

import yaml

from datamodules.generate.command import generate_command
from datamodules.schema import SPLITS
from fluidsnet.errors import UserError
from fluidsnet.progress import Progress
from fluidsnet.studies.ablations.report import write_report
from fluidsnet.studies.ablations.results import TrainedRun
from fluidsnet.studies.machine import cores
from fluidsnet.studies.parser import study_parser
from fluidsnet.studies.training import STAGES, Training

#: Configs in the order of composition; the scene's data config comes between the two.
_BEFORE_DATA = ("trainer.yaml", "model/paper.yaml")
_AFTER_DATA = ("study/ablations.yaml", "ablation/target.yaml", "ablation/global_feature.yaml")
#: Options of `fluidsnet fit` without a dot: sections, files, and the seed.
_WHOLE = re.compile(r"-[a-z]|--\w+(=|$)")
_ROOT = re.compile(r"--data\.(root|init_args|init_args\.root)(=|$)")

_DESCRIPTION = """\
Train the paper's network beside two twins, one that predicts the acceleration and one without the
global feature, on several scenes, time steps and seeds, and check the paper's claims. Missing data
are generated. An interrupted study resumes with the same command. The whole study takes about two
hours on two cores; a first try:
fluidsnet ablations --fit '[--trainer.max_steps=100]' --output runs/try \
--runs '[{"scene": "dam_break_small", "strides": [8], "seeds": [0]}]'
"""


@dataclass(frozen=True)
class SceneRuns:
    """Trainings on one scene: each stride with each seed.

    Attributes:
        scene: Name of its files in configs/scene and configs/data.
        strides: Frames of the data per step of the network.
        seeds: Global seeds of the trainings.
    """

    scene: str
    strides: list[int]
    seeds: list[int]


_DEFAULT_RUNS = (
    SceneRuns("dam_break_small", [1, 8], [0, 1, 2]),
    SceneRuns("drop_pool_small", [1, 8], [0]),
    SceneRuns("cuboid_basin_small", [1, 8], [0]),
)


@dataclass(frozen=True)
class AblationsOptions:
    """Options of the study.

    Attributes:
        runs: scenes, each with strides and seeds; those of docs/ablations.md by default.
        fit: further settings of `fluidsnet fit` for all trainings, such as
            ["--trainer.max_steps=100"]; weights are saved every 100 steps.
        configs: the folder of the configs.
        jobs: concurrent trainings, which share the cores of the CPU; 1 where there is one GPU.
        output: folder for the runs, and for ablations.md, its CSV files and its figures.
    """

    runs: list[SceneRuns] = field(default_factory=lambda: [*_DEFAULT_RUNS])
    fit: list[str] = field(default_factory=list)
    configs: str = "configs"
    jobs: int = 2
    output: str = "runs/ablations"

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise UserError(f"--jobs is {self.jobs}; it must be at least 1.")
        if not self.runs:
            raise UserError("--runs names no scene.")
        for runs in self.runs:
            if not runs.strides or min(runs.strides) < 1 or not runs.seeds:
                raise UserError(
                    f"--runs: {runs.scene} needs at least one stride, each 1 or more, and at "
                    "least one seed."
                )
        for argument in self.fit:
            # Files named here would not be hashed in a training's note, and may name other data.
            if _WHOLE.match(argument):
                raise UserError(
                    f"--fit takes single settings such as --trainer.max_steps=100, not {argument}; "
                    "files belong in the folder of --configs."
                )
            if _ROOT.match(argument):
                raise UserError(
                    f"--fit has {argument}, which would hold for all scenes; set the data of each "
                    f"scene in {self.configs}/data."
                )
        data = (f"data/{runs.scene}.yaml" for runs in self.runs)
        for name in (*_BEFORE_DATA, *_AFTER_DATA, *data):
            if not (Path(self.configs) / name).is_file():
                raise UserError(f"{self.configs}/{name} is missing; --configs names the folder.")


def ablations_command(arguments: list[str]) -> None:
    """Generate missing data, train and test unfinished runs, and write the report.

    Raises:
        UserError: An option is invalid, or trainings failed; the others are finished first.
    """
    parser = study_parser("ablations", _DESCRIPTION, AblationsOptions)
    values = vars(parser.instantiate(parser.parse_args(arguments)))
    values.pop("config")
    options = AblationsOptions(**values)
    trainings = _trainings(options)
    for scene in dict.fromkeys(run.scene for run in trainings):
        _generate(Path(options.configs), scene)
    failures = _train(trainings, options)
    print(f"\n{_report(trainings, options)}\nThis report is in {options.output}/ablations.md.")
    if failures:
        raise UserError("\n".join([*failures, "Fix this; the same command then does the rest."]))


def _trainings(options: AblationsOptions) -> dict[TrainedRun, Training]:
    configs = Path(options.configs)
    threads = max(1, cores() // options.jobs)
    trainings: dict[TrainedRun, Training] = {}
    for runs in options.runs:
        names = (*_BEFORE_DATA, f"data/{runs.scene}.yaml", *_AFTER_DATA)
        files = [configs / name for name in names]
        for seed, stride in product(runs.seeds, runs.strides):
            folder = Path(options.output, runs.scene, f"stride_{stride}", f"seed_{seed}")
            # Last, since the folder is named after them.
            settings = [f"--seed_everything={seed}", f"--data.init_args.stride={stride}"]
            training = Training(folder, files, [*options.fit, *settings], threads)
            trainings[TrainedRun(runs.scene, stride, seed, folder)] = training
    return trainings


def _generate(configs: Path, scene: str) -> None:
    """Generate the data of a scene where they are missing."""
    values: Any = yaml.safe_load((configs / "data" / f"{scene}.yaml").read_text())
    root = Path(values["data"]["init_args"]["root"])
    if not all((root / f"{split}.h5").exists() for split in SPLITS):
        generate_command([f"--config={configs / 'scene' / scene}.yaml", f"--root={root}"])


def _train(trainings: dict[TrainedRun, Training], options: AblationsOptions) -> list[str]:
    """Run unfinished trainings concurrently, write the report after each; return the failures."""
    unfinished = [training for training in trainings.values() if not training.done]
    failures: list[str] = []
    total = len(STAGES) * len(trainings)
    progress = Progress(total=total, desc="training and testing", unit="stage")
    progress.update(total - len(STAGES) * len(unfinished))

    def run_stages(training: Training) -> None:
        for stage in STAGES:
            training.run(stage)
            progress.update()

    pool = ThreadPoolExecutor(options.jobs)
    before = signal.signal(signal.SIGTERM, _terminated)
    try:
        for future in as_completed([pool.submit(run_stages, training) for training in unfinished]):
            error = future.exception()
            if isinstance(error, UserError):
                failures.append(str(error))
                print(error, file=sys.stderr)
            elif error is not None:
                raise error
            else:
                _report(trainings, options)
    finally:
        # The children get an interrupt from the keyboard, but no signal sent to this process.
        for training in unfinished:
            training.stop()
        pool.shutdown(cancel_futures=True)
        signal.signal(signal.SIGTERM, before)
        progress.close()
    return failures


def _terminated(number: int, frame: object) -> NoReturn:
    print("fluidsnet: terminated.", file=sys.stderr)
    sys.exit(128 + number)


def _report(trainings: dict[TrainedRun, Training], options: AblationsOptions) -> str:
    finished = [run for run, training in trainings.items() if training.done]
    return write_report(Path(options.output), finished, len(trainings))
