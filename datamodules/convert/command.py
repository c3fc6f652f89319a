"""``fluidsnet convert``: data of other formats to FluidsNet's, and to LagrangeBench's."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from jsonargparse import ArgumentParser

from datamodules.convert.deep_lagrangian_fluids import (
    DeepLagrangianFluids,
    is_deep_lagrangian_fluids,
)
from datamodules.convert.frames import FrameFolders, has_frames
from datamodules.convert.lagrangebench import LagrangeBench, is_lagrangebench
from datamodules.convert.options import Options
from datamodules.convert.simulation import Source
from datamodules.convert.to_lagrangebench import write_lagrangebench
from datamodules.convert.writer import write_files
from fluidsnet.errors import UserError

#: Formats, each with its test of a folder and its reader, in the order in which they are tried.
FORMATS: dict[str, tuple[Callable[[Path], bool], Callable[[Path, Options], Source]]] = {
    "lagrangebench": (is_lagrangebench, LagrangeBench),
    "deep_lagrangian_fluids": (is_deep_lagrangian_fluids, DeepLagrangianFluids),
    "frames": (has_frames, FrameFolders),
}


def convert_command(arguments: list[str]) -> None:
    """Convert a data set with the options given.

    Raises:
        UserError: The source cannot be read or represented, or an option is missing.
    """
    given = _parser().parse_args(arguments)
    source, root = Path(given.source), Path(given.root)
    if not source.is_dir():
        raise UserError(f"{source}: there is no such folder.")
    options = Options(**{name: getattr(given, name) for name in Options.__dataclass_fields__})
    if given.to is not None:
        if given.format is not None:
            raise UserError("--format is that of the source, and --to reads FluidsNet's; omit one.")
        options.refuse_others(frozenset(), "--to lagrangebench")
        files = write_lagrangebench(source, root)
        print(f"{root} holds {', '.join(path.name for path in files)}.")
        return
    data = FORMATS[given.format or _detect(source)][1](source, options)
    files = write_files(data, root)
    for note in dict.fromkeys(data.notes):
        print(f"note: {note}.", file=sys.stderr)
    for split, names in data.splits.items():
        print(f"{root / split}.h5: {len(names)} simulation(s)")
    print(f"Next: fluidsnet inspect {files[0]}")


def _detect(folder: Path) -> str:
    for name, (fits, _) in FORMATS.items():
        if fits(folder):
            return name
    own = [path.name for path in folder.glob("*.h5")]
    more = (
        f" It has {', '.join(sorted(own))}: is it a data set of FluidsNet already?" if own else ""
    )
    raise UserError(
        f"{folder}: its format is not known; expected metadata.json with train.h5 (LagrangeBench), "
        f"*.msgpack.zst (DeepLagrangianFluids), or numbered .vtk, .vtp, .vtu, .ply or .bgeo files."
        f"{more}"
    )


def _parser() -> ArgumentParser:
    parser = ArgumentParser(
        prog="fluidsnet convert",
        description=(
            "Convert a data set of another format to train.h5, val.h5 and test.h5: LagrangeBench, "
            "DeepLagrangianFluids (CConv), or folders of VTK, PLY or BGEO frames. With --to, "
            "convert a data set of FluidsNet to LagrangeBench's format."
        ),
    )
    parser.add_argument("source", type=str, metavar="SOURCE", help="folder of the data")
    parser.add_argument("--root", type=str, required=True, help="folder of the new data set")
    parser.add_argument("--format", choices=[*FORMATS], help="format; by default it is recognized")
    parser.add_argument("--to", choices=["lagrangebench"], help="format to write")
    parser.add_argument("--dt", type=float, help="time between two frames, s")
    parser.add_argument("--particle-radius", type=float, help="m")
    parser.add_argument(
        "--gravity", type=float, nargs=3, metavar=("X", "Y", "Z"), help="m/s², as in 0 -9.81 0"
    )
    parser.add_argument(
        "--domain",
        type=float,
        nargs=6,
        metavar=("X0", "Y0", "Z0", "X1", "Y1", "Z1"),
        help="lower and upper corner of the box, m",
    )
    parser.add_argument("--viscosity", type=float, help="coefficient of the solver")
    parser.add_argument("--density0", type=float, help="rest density, kg/m³")
    parser.add_argument("--walls", type=str, metavar="FILE", help="particles of walls at rest")
    parser.add_argument(
        "--frames", nargs="+", metavar="PATTERN", help="names of the fluid's files, as in 'Fluid_*'"
    )
    parser.add_argument(
        "--split",
        nargs="+",
        metavar="PART",
        help="simulations of each file, as in train=a,b val=c test=d, or shares: 0.8 0.1 0.1",
    )
    return parser
