"""``fluidsnet tune``: fit the numbers of a prior to data; the result is a config file."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml
from numpy.typing import NDArray
from scipy.optimize import minimize

from datamodules.reader import FrameReader
from fluidsnet.errors import UserError
from fluidsnet.folder_lock import FolderLock
from fluidsnet.models import load
from fluidsnet.priors import Prior
from fluidsnet.progress import Progress
from fluidsnet.reporting.table import markdown, write_csv
from fluidsnet.studies.machine import cores
from fluidsnet.studies.parser import parse_options
from fluidsnet.studies.tune.objective import Errors, Objective
from fluidsnet.whole_file import write_whole

#: Size of the first changes.
_CHANGE = 0.15


@dataclass(frozen=True)
class TuneOptions:
    """Options of the fit.

    Attributes:
        data: Data file to fit to; held-out simulations belong in another one.
        model: Config of a prior alone, whose numbers are the start.
        numbers: Arguments of the prior to fit, each between 0 and 1.
        stride: Frames in a step.
        simulations: Number of simulations, from the first in the file.
        samples: True states of each simulation that two steps start from.
        steps: Steps of a rollout of each simulation, from its first frame.
        evaluations: Number of settings that are tried.
        threads: Threads; all cores by default.
        output: Folder for the fitted config and the table of what was tried.
    """

    data: str = "data/box_drops/train.h5"
    model: str = "configs/model/prior.yaml"
    numbers: list[str] = field(
        default_factory=lambda: ["relaxation", "warm_start", "divergence_warm_start", "ahead"]
    )
    stride: int = 1
    simulations: int = 4
    samples: int = 12
    steps: int = 25
    evaluations: int = 100
    threads: int = field(default_factory=cores)
    output: str = "runs/tune"

    def __post_init__(self) -> None:
        for name in ("stride", "simulations", "samples", "steps", "evaluations"):
            if getattr(self, name) < 1:
                raise UserError(f"--{name} is {getattr(self, name)}; it must be at least 1.")
        if not 1 <= self.threads <= cores():
            raise UserError(f"--threads is {self.threads}; this process can use {cores()} cores.")
        if not self.numbers:
            raise UserError("--numbers is empty; name arguments of the prior to fit.")


def tune_command(arguments: list[str]) -> None:
    """Run the fit and print errors before and after.

    Raises:
        UserError: An option cannot be used, or the data or the config cannot be read.
    """
    options = parse_options(
        "tune",
        "Fit a few numbers of a prior to data by the simplex method of Nelder and Mead: the mean "
        "logarithm of its errors after one step, after two and at the end of a rollout, and of "
        "its velocities. The number of searches, substeps and sweeps, which decide the cost, stay "
        "as the config has them. Tune on training data, and compare on others: "
        "fluidsnet trade --models '[{model: runs/tune/prior.yaml}]'",
        TuneOptions,
        arguments,
    )
    torch.set_num_threads(options.threads)
    found = Fit(options)
    with FolderLock(Path(options.output)):
        found.run()
        print(found.write())
    print(f"Written to {options.output}: prior.yaml and tune.csv.")


class Fit:
    """Search for the numbers with the least score.

    Args:
        options: What to fit, and to what.

    Raises:
        UserError: The data or the config cannot be read, or the prior has no such number.
    """

    def __init__(self, options: TuneOptions) -> None:
        self.options = options
        self._model = load(options.model)
        self._start = [_number(self._model.prior, name) for name in options.numbers]
        reader = FrameReader(Path(options.data))
        simulations = [name for name in reader.frames if reader.frames[name] > 2 * options.stride]
        if not simulations:
            raise UserError(f"{options.data} has no simulation of two steps; set a lower --stride.")
        self._objective = Objective(
            reader,
            simulations[: options.simulations],
            options.samples,
            options.steps,
            options.stride,
        )
        #: What was tried, the start first.
        self.tried: list[tuple[list[float], Errors]] = []

    def run(self) -> None:
        """Try the settings."""
        count = len(self._start)
        # Inwards from the start, by as much for each number.
        start = np.clip(self._start, 0, 1)
        corners = np.where(start > 0.5, start - _CHANGE, start + _CHANGE)
        simplex = np.vstack([start, np.where(np.eye(count, dtype=bool), corners, start)])
        with Progress(total=self.options.evaluations, unit="setting") as bar:

            def score(numbers: NDArray[np.float64]) -> float:
                value = self._try(numbers.tolist())
                bar.update()
                return value

            minimize(
                score,
                start,
                method="Nelder-Mead",
                bounds=[(0, 1)] * count,
                options={
                    "initial_simplex": simplex,
                    "maxfev": self.options.evaluations,
                    "xatol": 1e-3,
                    "fatol": 1e-4,
                },
            )

    def write(self) -> str:
        """Write the config with the best numbers and the table; return errors as Markdown."""
        options, folder = self.options, Path(self.options.output)
        folder.mkdir(parents=True, exist_ok=True)
        best = min(self.tried, key=lambda it: it[1].score)
        columns = (*options.numbers, *Errors.__dataclass_fields__, "score")
        rows = [
            [*numbers, *asdict(errors).values(), errors.score] for numbers, errors in self.tried
        ]
        write_csv(folder / "tune.csv", columns, rows)
        config: dict[str, Any] = yaml.safe_load(Path(options.model).read_text(encoding="utf-8"))
        prior = config["model"]["init_args"]["prior"]
        fitted = {
            name: round(value, 3) for name, value in zip(options.numbers, best[0], strict=True)
        }
        prior["init_args"] = {**(prior.get("init_args") or {}), **fitted}
        text = yaml.safe_dump(config, sort_keys=False)
        write_whole(folder / "prior.yaml", f"# {options.model}, fitted to {options.data}\n{text}")
        return markdown(
            ("", *options.numbers, "1 step mm", "2 steps mm", "velocity m/s", "rollout mm"),
            [
                [
                    name,
                    *numbers,
                    1e3 * it.one_step,
                    1e3 * it.two_steps,
                    it.velocity,
                    1e3 * it.rollout,
                ]
                for name, (numbers, it) in (("before", self.tried[0]), ("after", best))
            ],
        )

    def _try(self, numbers: list[float]) -> float:
        for name, value in zip(self.options.numbers, numbers, strict=True):
            setattr(self._model.prior, name, value)
        errors = self._objective(self._model)
        self.tried.append((numbers, errors))
        return errors.score


def _number(prior: Prior, name: str) -> float:
    """Return a number of a prior.

    Raises:
        UserError: It has none of that name.
    """
    known = [key for key, value in vars(prior).items() if isinstance(value, float)]
    if name not in known:
        raise UserError(
            f"{type(prior).__name__} has no number {name!r} to fit; it has {', '.join(known)}."
        )
    return float(getattr(prior, name))
