"""Options of ``fluidsnet simulate``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final, get_args

import torch

from fluidsnet.errors import UserError
from fluidsnet.studies.parser import Parser
from fluidsnet.studies.simulate.start import Sampling, SceneChoice

_DESCRIPTION = (
    "Simulate a scene with a trained model in place of the solver, and write a trajectory for "
    "ParaView and a picture. No truth is needed. "
    "Example: fluidsnet simulate DoubleDamBreak.json --model box_drops --seconds 4"
)


@final
@dataclass(frozen=True)
class SimulateOptions:
    """Options of a simulation.

    Attributes:
        choice: Scene, and which of its starts.
        model: Folder of a run, name of a shipped model, or config file of a prior alone.
        seconds: Time to simulate, s.
        every: Steps between two stored frames.
        device: Device of the model: "auto", "cpu", "cuda" or "cuda:1".
        until_rest: Stop when the fluid rests.
        rest_speed: Speed below which it rests, m/s; None for the default.
        time_step: Time step of a model that takes any, s; None for 20 ms.
        movie: MP4 file; None for none.
        output: Folder of the results; None for one in runs/simulate.

    Raises:
        UserError: A value is not possible.
    """

    choice: SceneChoice
    model: str
    seconds: float
    every: int
    device: str
    until_rest: bool
    rest_speed: float | None
    time_step: float | None
    movie: Path | None
    output: Path | None

    def __post_init__(self) -> None:
        for name in ("seconds", "rest_speed", "time_step"):
            value = getattr(self, name)
            if value is not None and not 0 < value < math.inf:
                option = name.replace("_", "-")
                raise UserError(f"--{option} is {value}; set it above zero.")
        if self.every < 1:
            raise UserError(f"--every is {self.every}; set at least 1.")
        if self.rest_speed is not None and not self.until_rest:
            raise UserError("--rest-speed is for --until-rest; add that, or leave it out.")

    def torch_device(self) -> torch.device:
        """Return the device.

        Raises:
            UserError: There is no such device.
        """
        cuda = torch.cuda.is_available()
        if self.device == "auto":
            return torch.device("cuda" if cuda else "cpu")
        try:
            device = torch.device(self.device)
        except RuntimeError as error:
            raise UserError(f"--device is {self.device}; set cpu, cuda or auto.") from error
        count = torch.cuda.device_count() if cuda else 0
        if device.type == "cuda" and (device.index or 0) >= count:
            raise UserError(
                f"--device is {self.device}, and PyTorch finds {count or 'no'} CUDA device(s) "
                "here; use --device cpu."
            )
        if device.type not in ("cpu", "cuda"):
            raise UserError(f"--device is {self.device}; set cpu, cuda or auto.")
        return device


def parse_simulate(arguments: Sequence[str]) -> SimulateOptions:
    """Return the options from the command line.

    Raises:
        UserError: An argument cannot be used.
    """
    options: dict[str, Any] = vars(_parser().parse_args(list(arguments)))
    options.pop("config", None)
    names = SceneChoice.__dataclass_fields__
    choice = SceneChoice(**{name: options.pop(name) for name in names})
    for name in ("movie", "output"):
        options[name] = Path(options[name]) if options[name] else None
    return SimulateOptions(choice, **options)


def _parser() -> Parser:
    parser = Parser(prog="fluidsnet simulate", description=_DESCRIPTION)
    add = parser.add_argument
    add(
        "scene",
        type=str,
        metavar="SCENE",
        help="scene file of SPlisHSPlasH (path, or name of one that its package installs), config "
        "of random scenes such as configs/scene/box_drops.yaml, or data file FILE.h5",
    )
    add(
        "--model",
        type=str,
        required=True,
        help="name of a model that ships, such as box_drops, folder of a run, or config file of a "
        "prior alone",
    )
    add("--seconds", type=float, default=3.0, help="time to simulate, s")
    add("--every", type=int, default=1, help="steps between two stored frames")
    add("--device", type=str, default="auto", help="auto, cpu or cuda")
    add(
        "--until-rest",
        action="store_true",
        help="stop when nearly all particles have been slow for half a second",
    )
    add(
        "--rest-speed",
        type=float | None,
        help="speed below which the fluid rests, m/s; by default 0.15 times the root of "
        "gravity times particle radius",
    )
    add(
        "--simulation",
        type=str | None,
        help="simulation of a data file, such as 00000, or number of a random scene",
    )
    add("--frame", type=int | None, help="frame of a data file to start from; the first by default")
    add("--seed", type=int | None, help="seed of random scenes; that of the config by default")
    add(
        "--sampling",
        choices=get_args(Sampling),
        default="auto",
        help="what samples fluid and walls: the solver, or lattices, which need no solver",
    )
    add(
        "--time-step",
        type=float | None,
        help="time step of a prior that takes any, s; 0.02 by default",
    )
    add("--movie", type=str | None, metavar="FILE.mp4", help="write a movie, too")
    add("--output", type=str | None, help="folder of the results; by default in runs/simulate")
    return parser
