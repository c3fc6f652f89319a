"""The solver on the same start states."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import h5py
import numpy as np
import torch

from datamodules.generate.job import SOLVER_STEPS, SolverName
from datamodules.generate.replay import Replay, replay
from datamodules.schema import Header, SceneAttributes, create_frames
from fluidsnet.particles import Particles

#: Tolerance of the solver, per cent.
TOLERANCE = 0.05


def solver_states(
    start: Particles,
    steps: int,
    solver: SolverName,
    threads: int,
    advance: Callable[[], None],
    moved: float = 0.0,
) -> Iterator[Particles]:
    """Yield the states of the solver after 1, 2, … time steps of the scene; fewer if it ends.

    Args:
        start: Fluid in a closed box, one frame.
        steps: Number of steps.
        solver: Pressure solver, at its default step.
        threads: OpenMP threads.
        advance: Called now and then meanwhile.
        moved: Standard deviation of a noise on the start, m.

    Raises:
        UserError: The solver ended before its first state.
    """
    scene = start.scene
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "start.h5"
        _write(path, start)
        job = Replay(
            data=str(path),
            simulation="00000",
            solver=solver,
            solver_step=scene.time_step / max(round(scene.time_step / SOLVER_STEPS[solver]), 1),
            tolerance=TOLERANCE,
            threads=threads,
            runs=[(0, steps)],
            moved=moved,
        )
        for _, _, made in replay(job, advance):
            yield start.moved(torch.from_numpy(made.position), torch.from_numpy(made.velocity))


def _write(path: Path, start: Particles) -> None:
    """Write a data file of one frame."""
    scene = start.scene
    header = Header(
        scene="stress",
        solver="none",
        solver_version="none",
        solver_parameters={},
        particle_radius=scene.particle_radius,
        support_radius=scene.support_radius,
        dt=scene.time_step,
    )
    lower, upper, gravity = (
        tuple(it[0].tolist()) for it in (scene.domain_lower, scene.domain_upper, scene.gravity)
    )
    attributes = SceneAttributes(
        domain_lower=lower,
        domain_upper=upper,
        gravity=gravity,
        density0=float(scene.density0[0]),
        viscosity=float(scene.viscosity[0]),
    )
    with h5py.File(path, "w") as file:
        header.write(file)
        group = file.create_group("00000")
        attributes.write(group)
        group.attrs["scene_parameters"] = "[]"
        for data, values in zip(
            create_frames(group, len(start)), (start.position, start.velocity), strict=True
        ):
            data.resize(1, axis=0)
            data[0] = values.numpy()
        group["time"], group["solver_seconds"] = np.zeros(1), np.zeros(1)
        group["solid_position"] = start.solid_position.numpy()
