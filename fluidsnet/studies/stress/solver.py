"""The solver on the same start states."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import torch

from datamodules.generate.job import SOLVER_STEPS, SolverName
from datamodules.generate.replay import Replay, replay
from datamodules.schema import SceneAttributes
from datamodules.start_file import start_header, write_start
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
    header = start_header("stress", scene.particle_radius, scene.time_step)
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
    fluid = start.position.numpy(), start.velocity.numpy()
    header = replace(header, support_radius=scene.support_radius)
    write_start(path, header, attributes, fluid, start.solid_position.numpy())
