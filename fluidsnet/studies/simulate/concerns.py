"""Warnings where a scene leaves what a model was trained or tried on."""

from __future__ import annotations

import math
import os
import warnings
from pathlib import Path

import torch
import yaml
from torch import Tensor

from datamodules.reader import FrameReader
from fluidsnet.errors import UserError
from fluidsnet.metrics.density import Density
from fluidsnet.model import Model
from fluidsnet.models import config_path
from fluidsnet.models.tried_range import TriedRange, shipped_range
from fluidsnet.particles import Particles

#: Frames of the training data that are read for their greatest speed.
_FRAMES = 20
#: Excess density (99th percentile) of a start above which it is compressed.
_COMPRESSED = 0.1
#: Share by which a value may exceed the range without a warning.
_TOLERANCE = 0.02


def concerns(run: str, model: Model, start: Particles) -> list[str]:
    """Return warnings on a start; none if it resembles what the model was trained on.

    Args:
        run: Name or path of the model.
        model: The model.
        start: State of one frame.

    Raises:
        UserError: The model cannot step the scene.
    """
    if model.network.reads_guess and (doubts := model.prior.doubts(start.scene)):
        raise UserError(f"The fluid would burst apart: {doubts[0]}")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        model.check_scenes(start.scene)
    told = [str(it.message) for it in caught]
    known = shipped_range(run) or training_range(run)
    if known is None and model.network.target.width:
        told.append(
            f"The data that {run} was trained on are not here: particle radius, depth and speed "
            "of the scene are not compared with theirs."
        )
    elif known is not None:
        told += _beyond(known, model, start)
    return told + _bad_start(start)


def training_range(run: str) -> TriedRange | None:
    """Return the range of the training data of a run; None where they are not there."""
    try:
        config = yaml.safe_load(config_path(run).read_text())
        root = os.path.expandvars(config["data"]["init_args"]["root"])
        path = Path(root).expanduser() / "train.h5"
        reader = FrameReader(path)
    except (UserError, KeyError, TypeError):
        return None
    names, speeds, depths = list(reader.frames), [0.0], [0.0]
    for name in names[:: math.ceil(len(names) / _FRAMES)]:
        count = reader.frames[name]
        depths.append(depth(reader.state(name, 0, 1)))
        for frame in {0, count // 4, count // 2}:
            speeds.append(float(reader.fluid(name, frame)[1].norm(dim=1).max()))
    reader.close()
    return TriedRange(reader.header.particle_radius, max(depths), max(speeds))


def _beyond(known: TriedRange, model: Model, start: Particles) -> list[str]:
    """Return a sentence for each value of a start that is outside a range."""
    told, scene = [], start.scene
    radius = scene.particle_radius
    if abs(radius / known.particle_radius - 1) > 1e-3:
        why = "its numbers were chosen at that"
        if model.network.target.width:
            why = "its weights were trained at that alone"
        elif radius < known.particle_radius:
            why = "smaller particles need a shorter time step"
        told.append(
            f"The particles have a radius of {radius:g} m, and the model is for "
            f"{known.particle_radius:g} m; {why}."
        )
    limit = 1 + _TOLERANCE
    if (deep := depth(start)) > limit * known.depth:
        told.append(
            f"The water is {deep:.2g} m deep, and the model was tried up to {known.depth:.2g} m; "
            "see how the fluid comes to rest."
        )
    if (fast := greatest_speed(start)) > limit * known.speed:
        told.append(
            f"A fall through the scene reaches {fast:.2g} m/s, and the model was tried up to "
            f"{known.speed:.2g} m/s."
        )
    return told


def _bad_start(start: Particles) -> list[str]:
    """Return sentences on a start whose pressure explodes: fluid in walls, or compressed."""
    told, scene = [], start.scene
    beyond = (start.position < scene.domain_lower) | (start.position > scene.domain_upper)
    if scene.dimension == 2:
        beyond[:, 2] = False
    if outside := int(beyond.any(dim=1).sum()):
        told.append(f"{outside} of {len(start)} particles start outside the walls of the scene.")
    excess = float(torch.quantile(_sample(Density()(start)), 0.99)) - 1
    if excess > _COMPRESSED:
        told.append(
            f"The fluid starts compressed, by {100 * excess:.0f} % (99th percentile); it will "
            "burst apart in the first steps."
        )
    return told


def greatest_speed(start: Particles) -> float:
    """Return the speed of the fastest particle after a fall to the lowest corner, m/s."""
    scene = start.scene
    gravity = scene.gravity[0]
    lowest = torch.where(gravity < 0, scene.domain_lower[0], scene.domain_upper[0])
    fall = ((lowest - start.position) * gravity).sum(dim=1).clamp_min(0)
    return float((start.velocity.square().sum(dim=1) + 2 * fall).max().sqrt())


def depth(start: Particles) -> float:
    """Return the greatest depth of water, m: fluid above a cell of four radii, over its area.

    It is zero without gravity.
    """
    scene = start.scene
    pull = scene.gravity[0].abs()
    if not bool(pull.any()):
        return 0.0
    up, width = int(pull.argmax()), 4 * scene.particle_radius
    level = [axis for axis in range(scene.dimension) if axis != up]
    place = start.position[:, level]
    # Layers of a lattice are in the middle of halves of cells.
    cells = ((place - place.amin(dim=0)) / width + 0.25).floor().long()
    _, counts = torch.unique(cells, dim=0, return_counts=True)
    return float(counts.max()) * scene.particle_volume / width ** len(level)


def _sample(values: Tensor) -> Tensor:
    """Return at most a million values, evenly chosen; `torch.quantile` takes no more."""
    return values[:: math.ceil(len(values) / 1_000_000)]
