"""``fluidsnet inspect``: data files, and what a model builds for one of them."""

from __future__ import annotations

from argparse import ArgumentParser
from collections.abc import Sequence
from pathlib import Path

import torch

from datamodules.inspection import summarize
from datamodules.needs import grid_shape, varying
from datamodules.reader import FrameReader
from datamodules.schema import SPLITS
from fluidsnet.checksums import write_checksums
from fluidsnet.errors import UserError
from fluidsnet.models import load
from fluidsnet.models.loading import build, config_path, has_weights
from fluidsnet.neighbors import Auto
from fluidsnet.neighbors.reach import within_reach
from fluidsnet.particles import Particles
from fluidsnet.sph import NEIGHBORS
from fluidsnet.studies.plan.costs import Cost, measure_costs
from fluidsnet.studies.plan.parts import Part, parts_of

_DESCRIPTION = """
Print a summary of data files, and warn of suspicious values in them. With --model, print what a
model builds for the scene of a data file and what it leaves out, with the weights of each part and
its share of the time and memory of a step on this machine. With --hash, write SHA-256 checksums of
data files and checkpoints beside them, which are verified whenever these are read.
"""


def inspect_command(arguments: list[str]) -> None:
    """Print summaries of data files, or the plan of a model.

    Raises:
        UserError: A file is not valid, or damaged, or the model cannot step the scene.
    """
    parser = ArgumentParser(prog="fluidsnet inspect", description=_DESCRIPTION)
    parser.add_argument(
        "files", nargs="*", type=Path, metavar="FILE", help="data file or folder, such as data/demo"
    )
    parser.add_argument(
        "--model",
        help="config such as configs/model/paper.yaml, folder of a run, or a model that ships",
    )
    parser.add_argument("--data", type=Path, metavar="FILE", help="data file for --model")
    parser.add_argument("--stride", type=int, default=1, help="frames from a state to the next")
    parser.add_argument("--frame", type=int, default=0, help="frame that is stepped")
    parser.add_argument(
        "--hash",
        action="store_true",
        help="write checksums of the files, or of all .h5 and .ckpt in folders, to SHA256SUMS",
    )
    parser.add_argument(
        "--voxel-size",
        type=float,
        help="edge of a cell of the background grid, m; by default the support radius",
    )
    options = parser.parse_args(arguments)
    if options.model is None:
        if not options.files:
            raise UserError("name a data file, such as data/demo/train.h5.")
        if options.hash:
            for sums in write_checksums(_hashed(options.files)):
                print(sums)
            return
        damaged = []
        for file in _all_files(options.files):
            summary = summarize(file)
            print(summary.text)
            damaged += [str(file)] if summary.damaged else []
        if damaged:
            raise UserError(f"damaged, as above: {', '.join(damaged)}.")
        return
    path = options.data or next(iter(options.files), None)
    if path is None:
        raise UserError("--model needs the file of a scene: --data data/demo/test.h5.")
    print(describe_plan(options.model, path, options.stride, options.frame, options.voxel_size))


def _all_files(paths: Sequence[Path]) -> list[Path]:
    """Return files, and those of the splits in a folder.

    Raises:
        UserError: A folder has none.
    """
    found: list[Path] = []
    for path in paths:
        splits = [path / f"{split}.h5" for split in SPLITS] if path.is_dir() else [path]
        present = [it for it in splits if it.exists() or not path.is_dir()]
        if not present:
            raise UserError(f"{path} holds none of train.h5, val.h5 and test.h5.")
        found += present
    return found


def _hashed(paths: Sequence[Path]) -> list[Path]:
    """Return files, and the data files and checkpoints in folders.

    Raises:
        UserError: There are none.
    """
    found: list[Path] = []
    for path in paths:
        kinds = (".h5", ".ckpt")
        files = [it for it in path.rglob("*") if it.suffix in kinds] if path.is_dir() else [path]
        if not files or not files[0].is_file():
            raise UserError(f"{path}: there is no such file, or no data file or checkpoint in it.")
        found += sorted(files)
    return found


def describe_plan(
    name: str, path: Path, stride: int = 1, frame: int = 0, voxel_size: float | None = None
) -> str:
    """Return the plan of a model on the first simulation of a file, as text.

    Args:
        name: Config file of a model, folder of a run, or name of a model that ships.
        path: Data file.
        stride: Frames from a state to the next.
        frame: Frame that is stepped.
        voxel_size: Edge of a cell of the background grid, m; by default the support radius. A
            trained model has its own grid.

    Raises:
        UserError: The file or the model cannot be read, or the model is for other scenes.
    """
    reader = FrameReader(path)
    scenes = reader.scenes(stride)
    simulation = next(iter(reader.frames))
    if not 0 <= frame < reader.frames[simulation]:
        raise UserError(f"{path}: there is no frame {frame} of /{simulation}.")
    state = reader.state(simulation, frame, stride)
    reader.close()
    config = config_path(name)
    if config == Path(name) and has_weights(config):
        scene = state.scene
        torch.manual_seed(0)
        model = build(
            config,
            grid_shape(scene, voxel_size or scene.support_radius),
            dimension=scene.dimension,
            varying=varying(scenes),
        ).model.eval()
    else:
        model = load(name)
        model.check_time_step(state.scene.time_step)
    model.check_scenes(state.scene)
    reached = len(within_reach(state, Auto(NEIGHBORS)(state))[0].solid_position)
    parts, costs = parts_of(model, state, reached), measure_costs(model, state)
    where = f"{path}, /{simulation}, frame {frame}, a step of {1e3 * state.scene.time_step:g} ms"
    return "\n".join([f"{name} on {where}", *_counts(state, reached), "", _table(parts, costs)])


def _counts(state: Particles, reached: int) -> list[str]:
    fluid, solid = len(state), len(state.solid_position)
    return [
        f"  particles stored    {fluid:,} fluid, {solid:,} solid",
        f"  particles computed  {fluid:,} fluid, {reached:,} solid within a support radius of it",
    ]


def _table(parts: list[Part], costs: dict[str, Cost]) -> str:
    step = costs["step"]
    rows = [["part", "", "why", "weights", "ms", "%", "MB"]]
    for part in parts:
        cost = costs.get(part.cost or "")
        weights = "" if part.weights is None else f"{part.weights:,}"
        rows.append([part.name, "built" if part.built else "left out", part.why, weights])
        rows[-1] += _cells(cost, step)
    rows.append(["integrator, walls", "built", "", "", *_cells(costs["motion"], step)])
    total = sum(part.weights or 0 for part in parts)
    rows.append(["the whole step", "", "", f"{total:,}", *_cells(step, step)])
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    # Text to the left, numbers to the right.
    return "\n".join(
        "  ".join(
            cell.ljust(width) if at < 3 else cell.rjust(width)
            for at, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    )


def _cells(cost: Cost | None, step: Cost) -> list[str]:
    if cost is None:
        return ["", "", ""]
    share = 100 * cost.seconds / step.seconds
    return [f"{1e3 * cost.seconds:.2f}", f"{share:.0f}", f"{cost.bytes / 1e6:.1f}"]
