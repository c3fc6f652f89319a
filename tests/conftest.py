"""What several test files start from."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import torch

from fluidsnet.particles import Particles
from fluidsnet.scene import Scene
from tools.demo import reason_against_the_solver

#: Files that take longest, which start first, so that no worker waits for another in the end.
LONGEST = {
    *("test_cli.py", "test_ablations.py", "test_tutorial.py", "test_trade.py"),
    *("test_ablations_report.py", "test_report.py", "test_speed.py", "test_resume.py"),
}

DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the files that take longest first; pytest-xdist keeps that order."""
    items.sort(key=lambda item: item.path.name not in LONGEST)


@pytest.fixture
def sample() -> Path:
    """A small data set that the real IISPH solver made."""
    return Path(__file__).parent / "data" / "dam_break"


@pytest.fixture(scope="session")
def real_solver() -> None:
    """Skips what needs the solver where it cannot run, such as without libGL."""
    reason = reason_against_the_solver()
    if reason is not None:
        pytest.skip(reason)


@pytest.fixture
def default_signals() -> Iterator[None]:
    """Give child processes the default SIGINT and SIGTERM.

    A shell ignores SIGINT in background jobs, and child processes inherit an ignored signal.
    """
    defaults = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
    before = {number: signal.signal(number, default) for number, default in defaults.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture(params=DEVICES)
def device(request: pytest.FixtureRequest) -> torch.device:
    return torch.device(request.param)


@pytest.fixture
def scene(device: torch.device) -> Scene:
    return Scene.single(
        domain_lower=(0.0, 0.0, 0.0),
        domain_upper=(1.5, 1.0, 1.5),
        gravity=(0.0, -9.81, 0.0),
        particle_radius=0.05,
        support_radius=0.2,
        time_step=0.02,
        device=device,
    )


@pytest.fixture
def make_particles(scene: Scene, device: torch.device) -> Callable[..., Particles]:
    """Random frames: one for each pair of numbers of fluid and solid particles."""

    def make(*counts: tuple[int, int], seed: int = 0) -> Particles:
        random = torch.Generator("cpu").manual_seed(seed)
        frames = []
        for fluid, solid in counts:
            position, velocity, walls = (
                torch.rand((count, 3), generator=random) for count in (fluid, fluid, solid)
            )
            walls[:, 1] = 0
            frames.append(
                Particles.single(
                    position.to(device) * scene.extent,
                    2 * velocity.to(device) - 1,
                    walls.to(device) * scene.extent,
                    scene,
                )
            )
        return Particles.collate(frames)

    return make
