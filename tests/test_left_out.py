"""A part that a scene does not need changes nothing where it is built: the same bits."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from test_corrected import network
from torch import Tensor

from datamodules.reader import FrameReader
from datamodules.sph import SPHDataModule
from fluidsnet.calibration import measure_residuals
from fluidsnet.kernels import disabled
from fluidsnet.model import Model
from fluidsnet.particles import Particles
from fluidsnet.priors import FreeFall, PressureStep
from fluidsnet.walls import OpenWalls, StopAtWalls

PATHS = {"kernels": nullcontext, "torch": disabled}


@pytest.fixture(scope="module")
def corrected() -> Model:
    """A network on a pressure step, with weights that are not zero."""
    root = Path(__file__).parent / "data" / "dam_break"
    source = SPHDataModule(root, voxel_size=0.25)
    source.setup("fit")
    torch.manual_seed(0)
    model = network((4, 4, 4), PressureStep(divergence_sweeps=1)).model
    model.set_statistics(source.statistics, source.time_step)
    model.set_residuals(measure_residuals(model.prior, source.calibration_samples(4)))
    for weight in model.parameters():
        torch.nn.init.normal_(weight, std=0.05)
    source.teardown("fit")
    return model.eval().requires_grad_(False)


def frame(root: Path, number: int = 40) -> Particles:
    reader = FrameReader(root / "test.h5")
    state = reader.state(next(iter(reader.frames)), number, 1)
    reader.close()
    return state


def stepped(model: Model, state: Particles, path: str) -> tuple[Tensor, Tensor]:
    torch.manual_seed(0)
    context: AbstractContextManager[None] = PATHS[path]()
    with torch.no_grad(), context:
        after = model.step(state)
    assert torch.isfinite(after.position).all()
    return after.position, after.velocity


def assert_same(one: tuple[Tensor, Tensor], two: tuple[Tensor, Tensor]) -> None:
    for first, second in zip(one, two, strict=True):
        assert torch.equal(first, second)


@pytest.mark.parametrize("path", PATHS)
def test_motion_of_solids_that_rest(sample: Path, corrected: Model, path: str) -> None:
    state = frame(sample)
    moving = state.with_solids(state.solid_position, torch.zeros_like(state.solid_position))
    assert moving.solids_move and not state.solids_move
    assert_same(stepped(corrected, moving, path), stepped(corrected, state, path))
    pushed = moving.with_solids(moving.solid_position, torch.ones_like(moving.solid_position))
    assert not torch.equal(stepped(corrected, pushed, path)[1], stepped(corrected, state, path)[1])


@pytest.mark.parametrize("path", PATHS)
def test_solids_that_no_particle_reaches(sample: Path, corrected: Model, path: str) -> None:
    state = frame(sample)
    none = replace(
        state,
        solid_position=state.solid_position[:0],
        solid_velocity=state.solid_velocity[:0],
        solid_frame=state.solid_frame[:0],
    )
    reach = state.position.amax(dim=0) + 3 * state.scene.support_radius
    far = replace(state, solid_position=state.solid_position + reach)
    assert_same(stepped(corrected, far, path), stepped(corrected, none, path))
    assert not torch.equal(stepped(corrected, state, path)[1], stepped(corrected, none, path)[1])


@pytest.mark.parametrize("path", PATHS)
def test_viscosity_of_a_fluid_without_any(sample: Path, corrected: Model, path: str) -> None:
    state = frame(sample)

    def with_viscosity(value: float) -> Particles:
        scene = replace(state.scene, viscosity=torch.full_like(state.scene.viscosity, value))
        return replace(state, scene=scene)

    # So small that its acceleration is lost in rounding, yet computed.
    small = stepped(corrected, with_viscosity(1e-30), path)
    assert_same(small, stepped(corrected, with_viscosity(0.0), path))
    assert not torch.equal(stepped(corrected, with_viscosity(0.1), path)[1], small[1])


@pytest.mark.parametrize("path", PATHS)
def test_walls_that_no_particle_reaches(sample: Path, corrected: Model, path: str) -> None:
    state = frame(sample)
    scene = replace(
        state.scene,
        domain_lower=state.scene.domain_lower - 10,
        domain_upper=state.scene.domain_upper + 10,
    )
    inside = replace(state, scene=scene)
    walled, open_ = (
        corrected.twin({"walls": walls}).eval() for walls in (StopAtWalls(0.8), OpenWalls())
    )
    assert_same(stepped(walled, inside, path), stepped(open_, inside, path))


@pytest.mark.parametrize("path", PATHS)
def test_a_prior_that_nothing_reads(sample: Path, path: str) -> None:
    state = frame(sample)
    models = []
    for prior in (FreeFall(), PressureStep()):
        torch.manual_seed(0)
        models.append(Model((4, 4, 4), prior=prior).eval())
    assert_same(stepped(models[0], state, path), stepped(models[1], state, path))


@pytest.mark.parametrize("path", PATHS)
def test_the_place_of_a_plane_on_the_third_axis(sample: Path, path: str) -> None:
    whole = frame(sample)
    layer = (whole.position[:, 2] - whole.position[0, 2]).abs() < whole.scene.particle_radius

    def plane(height: float) -> Particles:
        def flat(vectors: Tensor, third: float) -> Tensor:
            return torch.cat([vectors[:, :2], torch.full_like(vectors[:, :1], third)], dim=1)

        # As the reader has it: a box one particle deep.
        radius = whole.scene.particle_radius
        scene = replace(
            whole.scene,
            dimension=2,
            domain_lower=flat(whole.scene.domain_lower, height - radius),
            domain_upper=flat(whole.scene.domain_upper, height + radius),
        )
        return Particles.single(
            flat(whole.position[layer], height),
            flat(whole.velocity[layer], 0.0),
            flat(whole.solid_position[:50], height),
            scene,
        )

    torch.manual_seed(0)
    model = Model((4, 4, 1), dimension=2).eval()
    low, high = stepped(model, plane(0.25), path), stepped(model, plane(0.75), path)
    assert torch.equal(low[0][:, :2], high[0][:, :2])
    assert_same((low[1], low[1]), (high[1], high[1]))
    assert torch.equal(low[0][:, 2], torch.full_like(low[0][:, 2], 0.25))
