"""Start of a simulation as a data file of one frame: sampled by the solver, or on lattices."""

from __future__ import annotations

import ctypes
import tempfile
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from datamodules.generate.bodies import MovingBody
from datamodules.generate.job import DrawnJob, Job
from datamodules.generate.lattice import body_lattice, box_lattice, clear_of
from datamodules.generate.process import run_job
from datamodules.generate.scene_file_job import SceneFileJob
from datamodules.generate.scene_file_lattice import Sampled, sample_scene_file
from datamodules.start_file import start_header, write_start
from fluidsnet.errors import UserError


def solver_is_installed() -> bool:
    """Return whether the solver and the system library that it needs are installed."""
    try:
        ctypes.CDLL("libGL.so.1")
    except OSError:
        return False
    return find_spec("pysplishsplash") is not None


def solver_start(job: Job) -> None:
    """Let the solver sample fluid and walls in its process, and write the frame to `job.output`.

    Args:
        job: Settings of the simulation; the solver takes no step.

    Raises:
        UserError: The solver cannot be run, or fails.
    """
    output = Path(job.output)
    with tempfile.TemporaryDirectory(dir=output.parent) as scratch:
        reason = run_job(output.stem, replace(job, frames=1), Path(scratch))
    if reason is not None:
        raise UserError(
            f"The solver could not sample the scene: {reason}. With --sampling lattice it is not "
            "needed."
        )


def lattice_start(job: DrawnJob | SceneFileJob) -> None:
    """Sample fluid and walls on lattices, without the solver, and write `job.output`.

    Args:
        job: Settings of the simulation.

    Raises:
        UserError: The scene has what only the solver can sample.
    """
    header, radius = job.header, job.header.particle_radius
    if isinstance(job, DrawnJob):
        sampled = _drawn(job)
    else:
        path = Path(job.folder) / f"{header.scene}.json"
        sampled = sample_scene_file(path, job.content, radius)
    if not len(sampled.position):
        raise UserError(f"{header.scene}: no particle of {radius:g} m fits into the fluid.")
    solids = np.concatenate([np.empty((0, 3)), *sampled.solids])
    everything = np.concatenate([sampled.position, solids])
    box = job.closed_box(sampled.solids) or (everything.min(axis=0), everything.max(axis=0))
    write_start(
        Path(job.output),
        start_header(header.scene, radius, header.dt),
        job.attributes(*box),
        (sampled.position, sampled.velocity),
        solids,
        seed=job.seed,
    )


def _drawn(job: DrawnJob) -> Sampled:
    """Return the particles of a drawn scene, those of solids that move after the walls."""
    scene, radius = job.scene, job.header.particle_radius
    position = [clear_of(job.solids, body_lattice(it, radius), radius) for it in job.bodies]
    speeds = [it.velocity if isinstance(it, MovingBody) else (0.0, 0.0, 0.0) for it in job.bodies]
    velocity = [np.broadcast_to(v, p.shape) for v, p in zip(speeds, position, strict=True)]
    lower, upper = np.array(scene.domain_lower), np.array(scene.domain_upper)
    solids = [box_lattice(lower, upper, radius, flat=scene.dimension == 2)]
    for solid in job.solids:
        center, half = np.array(solid.center), np.array(solid.edges) / 2
        solids.append(box_lattice(center - half, center + half, radius))
    return Sampled(np.concatenate(position), np.concatenate(velocity), solids)
