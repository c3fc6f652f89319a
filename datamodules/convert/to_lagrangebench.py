"""Writer of LagrangeBench's format, for its loader and its networks.

A folder with ``train.h5``, ``valid.h5``, ``test.h5`` and ``metadata.json``, as the reader in
`datamodules.convert.lagrangebench` expects. The groups also have data sets and attributes that
LagrangeBench ignores, so that converting back loses nothing: ``velocity``, ``time``,
``solver_seconds`` and the attributes of the scene.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from datamodules.convert.lagrangebench import FILES, FLUID, METADATA, MOVING_WALL, WALL
from datamodules.convert.lagrangebench_statistics import TrajectoryStatistics
from datamodules.convert.simulation import Array
from datamodules.convert.writer import check_free
from datamodules.schema import (
    COMPRESSION,
    DAMAGE,
    Header,
    SceneAttributes,
    open_valid,
    simulations,
)
from fluidsnet.disk_space import check_space, not_written
from fluidsnet.errors import UserError
from fluidsnet.progress import Progress


def write_lagrangebench(folder: Path, root: Path) -> list[Path]:
    """Write a data set of FluidsNet in LagrangeBench's format; return the files.

    Args:
        folder: Folder of the data set.
        root: Folder to write; it must not hold such files already.

    Raises:
        UserError: A file is not valid, or the simulations differ in their number of frames, box,
            periodic axes or dimension, for which LagrangeBench has one value; or the disk is full.
    """
    present = {split: folder / f"{split}.h5" for split in FILES}
    present = {split: path for split, path in present.items() if path.is_file()}
    if not present:
        raise UserError(f"{folder} has no train.h5, val.h5 or test.h5; give a data set's folder.")
    check_free(root, [*FILES.values(), "metadata.json"])
    targets = {split: root / FILES[split] for split in present}
    partial = {split: target.with_suffix(".h5.tmp") for split, target in targets.items()}
    statistics: list[TrajectoryStatistics] = []
    shapes: dict[str, list[tuple[int, int]]] = {}
    try:
        with Progress(total=_count(present), unit="frame", desc="converting") as bar:
            for split, path in present.items():
                check_space(partial[split])
                with open_valid(path) as source, h5py.File(partial[split], "w") as target:
                    _check_alike(path, source, statistics)
                    shapes[split] = []
                    for number, name in enumerate(simulations(source)):
                        group = target.create_group(f"{number:05d}")
                        statistics.append(_write(source[name], group, bar))
                        shapes[split].append(group["position"].shape[:2])
        with open_valid(next(iter(present.values()))) as source:
            metadata = _metadata(source, shapes, statistics)
        note = root / "metadata.json.tmp"
        note.write_text(json.dumps(metadata, indent=4))
        for split, path in partial.items():
            path.replace(targets[split])
        note.replace(root / "metadata.json")
    except DAMAGE as error:
        damaged = UserError(f"{folder}: a frame cannot be read; it is damaged ({error}).")
        raise not_written(error) or damaged from error
    finally:
        for path in [*partial.values(), root / "metadata.json.tmp"]:
            path.unlink(missing_ok=True)
    return [*targets.values(), root / "metadata.json"]


def _count(files: dict[str, Path]) -> int:
    """Return the number of frames of all simulations in files."""
    total = 0
    for path in files.values():
        with open_valid(path) as file:
            total += sum(len(file[name]["position"]) for name in simulations(file))
    return total


def _check_alike(path: Path, file: h5py.File, before: list[TrajectoryStatistics]) -> None:
    """Check that simulations share what LagrangeBench has one value of."""
    scenes = [SceneAttributes.read(file[name]) for name in simulations(file)]
    for name in ("domain_lower", "domain_upper", "periodic", "dimension"):
        values = [getattr(scene, name) for scene in [*(it.scene for it in before[:1]), *scenes]]
        if values.count(values[0]) < len(values):
            raise UserError(
                f"{path}: {name} differs between simulations, and LagrangeBench has one for all; "
                "convert those that share it."
            )
    lengths = {len(file[name]["position"]) for name in simulations(file)}
    if len(lengths) > 1:
        raise UserError(
            f"{path}: its simulations have {min(lengths)} to {max(lengths)} frames, and "
            "LagrangeBench's loader takes the number of the first for all; give them one length."
        )


def _write(source: h5py.Group, target: h5py.Group, bar: Progress) -> TrajectoryStatistics:
    """Write a simulation frame by frame; return the statistics of its fluid."""
    scene = SceneAttributes.read(source)
    scene.write(target)
    for name in source.attrs:
        if name not in SceneAttributes.__dataclass_fields__:
            target.attrs[name] = source.attrs[name]
    for name in ("time", "solver_seconds"):
        target[name] = source[name][()]
    if scene.dimension == 2:
        target.attrs["plane"] = float(source["position"][0, 0, 2])
    kind, path = _particle_type(source), Path(target.file.filename)
    check_space(path, kind.nbytes)
    target["particle_type"] = kind
    rows = [np.flatnonzero(kind == FLUID), np.flatnonzero(np.isin(kind, (WALL, MOVING_WALL)))]
    frames = len(source["position"])
    shape = frames, len(kind), scene.dimension
    position, velocity = (
        target.create_dataset(
            name, shape=shape, chunks=(1, *shape[1:]), dtype=source["position"].dtype, **COMPRESSION
        )
        for name in ("position", "velocity")
    )
    moving = source["solid_position"].ndim == 3
    rest = None if moving else source["solid_position"][()]
    statistics = TrajectoryStatistics(scene)
    for frame in range(frames):
        target.file.flush()
        check_space(path, 2 * position.dtype.itemsize * shape[1] * shape[2])
        fluid = source["position"][frame]
        solid = source["solid_position"][frame] if rest is None else rest
        speeds = source["solid_velocity"][frame] if rest is None else np.zeros_like(rest)
        for dataset, parts in (
            (position, (fluid, solid)),
            (velocity, (source["velocity"][frame], speeds)),
        ):
            values = np.zeros(shape[1:], dataset.dtype)
            for where, part in zip(rows, parts, strict=True):
                values[where] = part[:, : scene.dimension]
            dataset[frame] = values
        statistics.add(fluid[:, : scene.dimension])
        bar.update()
    return statistics


def _particle_type(group: h5py.Group) -> Array:
    """Return the types of fluid and solids, in the order of the rows that are written.

    Simulations that came from LagrangeBench have them; in others the fluid is first.
    """
    fluid, solids = group["position"].shape[1], group["solid_position"]
    solid = solids.shape[-2]
    known = group.get("particle_type")
    if isinstance(known, h5py.Dataset):
        types = np.asarray(known[()])
        if ((types == FLUID).sum(), np.isin(types, (WALL, MOVING_WALL)).sum()) == (fluid, solid):
            return types
    kind = np.full(fluid + solid, WALL)
    kind[:fluid] = FLUID
    if solids.ndim == 3:
        moved = np.zeros(solid, bool)
        for frame in range(len(solids)):
            moved |= (solids[frame] != solids[0]).any(axis=1)
            moved |= group["solid_velocity"][frame].any(axis=1)
        kind[fluid:][moved] = MOVING_WALL
    return kind


def _metadata(
    file: h5py.File,
    shapes: dict[str, list[tuple[int, int]]],
    statistics: list[TrajectoryStatistics],
) -> dict[str, Any]:
    """Return the content of ``metadata.json``."""
    header = Header.read(file)
    scene = statistics[0].scene
    counts = [particles for rows in shapes.values() for _, particles in rows]
    dimension = scene.dimension
    metadata = {
        "case": header.scene,
        "solver": header.solver,
        "dim": dimension,
        "dx": 2 * header.particle_radius,
        "dt": header.dt,
        "write_every": 1,
        "viscosity": scene.viscosity,
        "g_ext_magnitude": float(np.linalg.norm(scene.gravity)),
        "num_particles_max": max(counts),
        "periodic_boundary_conditions": list(scene.periodic[:dimension]),
        "bounds": np.transpose([scene.domain_lower, scene.domain_upper])[:dimension].tolist(),
        # LagrangeBench's own: about one and a half spacings.
        "default_connectivity_radius": float(f"{1.45 * 2 * header.particle_radius:.3g}"),
        **TrajectoryStatistics.normalization(statistics),
        "gravity": list(scene.gravity),
        "solver_version": header.solver_version,
        "solver_parameters": header.solver_parameters,
        "support_radius": header.support_radius,
    }
    for split, word in (("train", "train"), ("test", "test")):
        if rows := shapes.get(split) or next(iter(shapes.values())):
            # Less the last frame, which is a target only.
            metadata[f"sequence_length_{word}"] = rows[0][0] - 1
            metadata[f"num_trajs_{word}"] = len(shapes.get(split, ()))
    metadata["t_end"] = header.dt * (metadata["sequence_length_train"])
    source = dict(header.solver_parameters.get(METADATA, {}))
    # What an option of the import changed is not that of the source.
    step = float(source.get("dt", header.dt)) * float(source.get("write_every", 1))
    if not np.isclose(step, header.dt):
        source = {name: it for name, it in source.items() if name not in ("dt", "write_every")}
    if not np.isclose(float(source.get("dx", 0)), metadata["dx"]):
        source.pop("dx", None)
    return {**metadata, **source}
