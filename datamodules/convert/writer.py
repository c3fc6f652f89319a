"""Writer of converted simulations: streams their frames into data files."""

from __future__ import annotations

from itertools import chain
from pathlib import Path

import h5py
import numpy as np

from datamodules.convert.simulation import Array, Frame, Simulation, Source
from datamodules.schema import COMPRESSION, DAMAGE, SPLITS, create_frames, validate
from fluidsnet.disk_space import check_space, not_written
from fluidsnet.errors import UserError
from fluidsnet.progress import Progress


def write_files(source: Source, root: Path) -> list[Path]:
    """Write a data file for each split of a source; return their paths.

    The files appear when all of them are complete.

    Args:
        source: Data of another format.
        root: Folder of the data set; it must not hold one already.

    Raises:
        UserError: The folder holds data, a simulation cannot be converted, or the disk is full.
    """
    check_free(root, [f"{split}.h5" for split in SPLITS])
    targets = {split: root / f"{split}.h5" for split in source.splits}
    partial = {split: target.with_suffix(".h5.tmp") for split, target in targets.items()}
    try:
        with Progress(total=source.frames, unit="frame", desc="converting") as bar:
            for split, path in partial.items():
                check_space(path)
                with h5py.File(path, "w") as file:
                    source.header.write(file)
                    for number, name in enumerate(source.splits[split]):
                        group = file.create_group(f"{number:05d}")
                        group.attrs["source"] = name
                        try:
                            _write(group, source.open(split, name), source.header.dt, bar)
                        except UserError as error:
                            raise UserError(f"{name}: {error}") from error
                        except DAMAGE as error:
                            raise not_written(error) or UserError(
                                f"{name}: it cannot be read, or its copy not written: {error}."
                            ) from error
                validate(path)
        for split, path in partial.items():
            path.replace(targets[split])
    finally:
        for path in partial.values():
            path.unlink(missing_ok=True)
    return list(targets.values())


def check_free(root: Path, names: list[str]) -> None:
    """Make a folder, and check that it has none of some files.

    Raises:
        UserError: It has one, or is no folder.
    """
    if taken := [name for name in names if (root / name).exists()]:
        raise UserError(f"{root} already holds {', '.join(taken)}; choose another --root.")
    try:
        root.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(
            f"{root} cannot be made: {error.strerror}; choose another --root."
        ) from error


def _write(group: h5py.Group, simulation: Simulation, interval: float, bar: Progress) -> None:
    """Write a simulation to its group, one frame after the other."""
    simulation.scene.write(group)
    for name, value in simulation.attributes.items():
        group.attrs[name] = value
    frames = simulation.frames()
    first = next(frames, None)
    if first is None or not len(first.position):
        raise UserError("there is no fluid particle in it.")
    datasets = [*create_frames(group, len(first.position))]
    if first.solid_position is not None:
        names = ("solid_position", "solid_velocity")
        datasets += create_frames(group, len(first.solid_position), names)
    count, path = 0, Path(group.file.filename)
    for frame in chain([first], frames):
        _check(frame, first, count)
        check_space(path, sum(values.nbytes for values in frame if values is not None))
        for dataset, values in zip(datasets, frame, strict=False):
            dataset.resize(count + 1, axis=0)
            dataset[count] = values
        group.file.flush()
        count += 1
        bar.update()
    further: dict[str, Array] = {
        "time": interval * np.arange(count),
        "solver_seconds": np.zeros(count),
        **simulation.datasets,
    }
    if first.solid_position is None:
        further["solid_position"] = np.asarray(simulation.solid_position, np.float32)
    check_space(path, sum(values.nbytes for values in further.values()))
    for name, values in further.items():
        group.create_dataset(name, data=values, **COMPRESSION)


def _check(frame: Frame, first: Frame, index: int) -> None:
    """Check that a frame has the particles of the first one, and finite numbers."""
    for values, expected in zip(frame, first, strict=True):
        if values is None or expected is None:
            continue
        if len(values) != len(expected):
            raise UserError(
                f"the number of particles changes from {len(expected)} to {len(values)} at frame "
                f"{index}; inlets, outlets and emitters are not supported, so leave the "
                "simulation out."
            )
        if not np.isfinite(values).all():
            raise UserError(
                f"frame {index} has numbers that are not finite; leave the simulation out."
            )
