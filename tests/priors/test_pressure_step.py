"""The coarse SPH step: kernel against torch, symmetries, and frames of the real solver."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from datamodules.reader import FrameReader
from fluidsnet.baselines import ballistic
from fluidsnet.errors import UserError
from fluidsnet.kernels import disabled
from fluidsnet.particles import Particles
from fluidsnet.priors import FreeFall, PressureStep
from fluidsnet.scene import Scene
from fluidsnet.sph import cubic_spline, solid_volumes, spline_slope

RADIUS, EDGE = 0.05, 1.2
GRAVITY = (0.0, -9.81, 0.0)


def scene(
    edge: float = EDGE,
    gravity: tuple[float, float, float] = GRAVITY,
    viscosity: float = 0.05,
    time_step: float = 0.02,
) -> Scene:
    return Scene.single(
        (0.0, 0.0, 0.0), (edge, edge, edge), gravity, RADIUS, 4 * RADIUS, time_step,
        viscosity=viscosity,
    )  # fmt: skip


def block(
    layers: int = 6, seed: int = 0, walls: bool = True, where: Scene | None = None
) -> Particles:
    """Return a compressed block of fluid on the floor of a corner, and particles on its walls."""
    random = torch.Generator().manual_seed(seed)
    grid = torch.stack(
        torch.meshgrid(*[torch.arange(layers, dtype=torch.float32)] * 3, indexing="ij"), dim=-1
    ).reshape(-1, 3)
    position = RADIUS * (1.1 + 1.9 * grid)
    position = position + 0.1 * RADIUS * torch.randn(position.shape, generator=random)
    velocity = 0.5 * torch.randn(position.shape, generator=random)
    flat = torch.cartesian_prod(*[torch.arange(0, EDGE, 2 * RADIUS)] * 2)
    zero = torch.zeros(len(flat), 1)
    sides = [torch.cat([flat[:, :axis], zero, flat[:, axis:]], dim=1) for axis in range(3)]
    solids = torch.cat(sides) if walls else torch.empty(0, 3)
    return Particles.single(position, velocity, solids, where or scene())


def both_paths(prior: PressureStep, particles: Particles) -> tuple[list[Tensor], list[Tensor]]:
    with torch.no_grad():
        guesses = [prior(particles, True)]
        with disabled():
            guesses.append(prior(particles, True))
    first, second = ([g.position, g.velocity, g.columns] for g in guesses)
    return first, second


def with_moving_walls(state: Particles, velocity: tuple[float, float, float]) -> Particles:
    speed = torch.tensor(velocity).expand(len(state.solid_position), 3)
    turn = 0.3 * torch.randn(speed.shape, generator=torch.Generator().manual_seed(3))
    return state.with_solids(state.solid_position, speed + turn)


def flat_block() -> Particles:
    """Return one layer of the block, with the walls in its plane, in two dimensions."""
    state, plane = block(), 1.1 * RADIUS

    def flat(vectors: Tensor, height: float) -> Tensor:
        return torch.cat([vectors[:, :2], torch.full((len(vectors), 1), height)], dim=1)

    lower, upper = torch.zeros(3), torch.full((3,), EDGE)
    lower[2], upper[2] = plane - RADIUS, plane + RADIUS
    where = Scene.single(
        lower.tolist(), upper.tolist(), GRAVITY, RADIUS, 4 * RADIUS, 0.02, viscosity=0.05,
        dimension=2,
    )  # fmt: skip
    fluid, walls = state.position[:, 2] < 2 * RADIUS, state.solid_position[:, 2] == 0
    return Particles.single(
        flat(state.position[fluid], plane),
        flat(state.velocity[fluid], 0.0),
        flat(state.solid_position[walls & (state.solid_position[:, :2] == 0).any(dim=1)], plane),
        where,
    )


CASES = {
    "walls that move": lambda: with_moving_walls(block(), (0.4, 0.3, -0.6)),
    "walls of one frame move": lambda: Particles.collate(
        [block(), with_moving_walls(block(4, 1), (0.4, 0.0, 0.0))]
    ),
    "walls": lambda: block(),
    "no walls": lambda: block(walls=False),
    "two frames": lambda: Particles.collate(
        [block(), block(4, 1, where=scene(2.0, (1.0, -5.0, 0.0), 0.2))]
    ),
    "one particle": lambda: block(1),
    "two at one place": lambda: Particles.single(
        torch.full((2, 3), 0.4), torch.eye(3)[:2], torch.empty(0, 3), scene()
    ),
    "two dimensions": lambda: flat_block(),
    "outside": lambda: (it := block()).moved(it.position - 0.06, it.velocity),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("settings", [{}, {"searches": 1, "substeps": 3, "divergence_sweeps": 0}])
def test_the_kernel_is_the_torch_reference(case: str, settings: dict[str, int]) -> None:
    found, expected = both_paths(PressureStep(**settings), CASES[case]())
    for one, other, tolerance in zip(found, expected, (1e-5, 5e-4, 2e-2), strict=True):
        assert one.isfinite().all()
        torch.testing.assert_close(one, other, atol=tolerance, rtol=1e-3)


def test_neighbors_are_all_fluid_ones_within_the_support_radius() -> None:
    # At rest and with one search, the places of the search are those of the particles.
    state = block()
    state = replace(
        state.moved(state.position, torch.zeros_like(state.velocity)),
        scene=scene(gravity=(0.0, 0.0, 0.0)),
    )
    distance = torch.cdist(state.position.double(), state.position.double())
    near = (distance <= 4 * RADIUS) & ~torch.eye(len(state), dtype=torch.bool)
    for context in (torch.no_grad, disabled):
        with context():
            edges = PressureStep(searches=1)(state, True).neighbors
        assert edges is not None
        pairs = torch.zeros_like(near)
        pairs[edges.particle, edges.neighbor] = True
        assert torch.equal(pairs, near) and len(edges.neighbor) == int(near.sum())
        assert torch.equal(pairs, pairs.T)
        assert torch.equal(edges.offset.diff(), near.sum(dim=1))


def test_a_mixed_batch_steps_as_its_frames_alone() -> None:
    frames = [block(), block(4, 1, where=scene(2.0, (1.0, -5.0, 0.0), 0.2)), block(1)]
    prior = PressureStep()
    batch = prior(Particles.collate(frames))
    alone = [prior(frame) for frame in frames]
    torch.testing.assert_close(batch.position, torch.cat([it.position for it in alone]))
    torch.testing.assert_close(batch.velocity, torch.cat([it.velocity for it in alone]))


@pytest.mark.parametrize("compiled", [True, False])
def test_fluid_and_walls_in_a_moving_frame_step_as_at_rest(compiled: bool) -> None:
    """Galilean invariance: solids that move with the fluid act on it as solids at rest."""
    wide = Scene.single(
        (-9.0, -9.0, -9.0), (9.0, 9.0, 9.0), GRAVITY, RADIUS, 4 * RADIUS, 0.02, viscosity=0.05
    )
    state, prior = replace(block(), scene=wide), PressureStep()
    wind = torch.tensor([1.0, -0.5, 2.0])
    carried = state.moved(state.position, state.velocity + wind).with_solids(
        state.solid_position, wind.expand_as(state.solid_position)
    )
    with torch.no_grad() if compiled else disabled():
        expected, found = prior(state), prior(carried)
        still = prior(replace(carried, solids_move=False))
    torch.testing.assert_close(found.position, expected.position + 0.02 * wind, atol=2e-5, rtol=0)
    torch.testing.assert_close(found.velocity, expected.velocity + wind, atol=2e-3, rtol=0)
    # Walls that the step takes to be at rest do something else.
    assert (still.velocity - expected.velocity - wind).abs().max() > 0.1


def test_permuted_particles_step_to_the_permuted_state() -> None:
    state, prior = block(), PressureStep()
    order = torch.randperm(len(state), generator=torch.Generator().manual_seed(1))
    expected = prior(state)
    found = prior(state.moved(state.position[order], state.velocity[order]))
    torch.testing.assert_close(found.position, expected.position[order], atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(found.velocity, expected.velocity[order], atol=2e-4, rtol=1e-4)


def test_a_lone_particle_falls_as_the_solver_lets_it() -> None:
    high = Particles.single(
        torch.tensor([[0.6, 0.9, 0.6]]),
        torch.tensor([[0.3, 0.0, -0.2]]),
        torch.empty(0, 3),
        scene(),
    )
    guess = PressureStep()(high)
    # Eight steps of symplectic Euler, 2.5 ms each.
    fall = torch.tensor([0.0, -0.5625 * 9.81 * 0.02**2, 0.0])
    expected = high.position + 0.02 * high.velocity + fall
    torch.testing.assert_close(guess.position, expected, atol=1e-6, rtol=0)
    torch.testing.assert_close(guess.velocity, ballistic(high).velocity)
    # As fine as the solver's own steps in the limit: the exact parabola.
    fine = PressureStep(solver_step=1e-5)(high)
    torch.testing.assert_close(fine.position, FreeFall()(high).position, atol=2e-6, rtol=0)


def test_momentum_is_conserved_without_walls_and_gravity() -> None:
    # Viscosity as in SPlisHSPlasH weighs a neighbor by its density, which is not symmetric.
    state = block(walls=False, where=scene(8.0, (0.0, 0.0, 0.0), viscosity=0.0))
    state = state.moved(state.position + 4.0, state.velocity)
    guess = PressureStep(sweeps=6)(state)
    assert (guess.velocity - state.velocity).abs().max() > 0.1
    torch.testing.assert_close(
        guess.velocity.mean(dim=0), state.velocity.mean(dim=0), atol=1e-5, rtol=0
    )


def test_a_scaled_scene_steps_to_the_scaled_state() -> None:
    # Lengths by s², times by s: gravity and speeds over times stay.
    scale, state = 2.0, block()
    before = state.scene
    larger = replace(
        state,
        position=scale**2 * state.position,
        velocity=scale * state.velocity,
        solid_position=scale**2 * state.solid_position,
        scene=replace(
            before,
            domain_upper=scale**2 * before.domain_upper,
            particle_radius=scale**2 * before.particle_radius,
            support_radius=scale**2 * before.support_radius,
            time_step=scale * before.time_step,
            viscosity=scale**3 * before.viscosity,
            edges=tuple(tuple(scale**2 * edge for edge in it) for it in before.edges),
        ),
    )
    expected = PressureStep()(state, True)
    found = PressureStep(solver_step=scale * 0.0025)(larger, True)
    torch.testing.assert_close(found.position / scale**2, expected.position, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(found.velocity / scale, expected.velocity, atol=5e-4, rtol=1e-4)
    torch.testing.assert_close(found.columns, expected.columns, atol=1e-2, rtol=1e-3)


def test_sweeps_reduce_compression() -> None:
    state = block()
    excess = []
    for sweeps in (0, 2, 20):
        columns = PressureStep(sweeps=sweeps, divergence_sweeps=0)(state, True).columns
        assert columns is not None
        excess.append(float(columns[:, 0].clamp_min(0).mean()))
    assert excess[0] > 2 * excess[1] > 2 * excess[2]


def test_gradients_are_those_of_free_fall() -> None:
    state = block()
    position, velocity = state.position.requires_grad_(), state.velocity.requires_grad_()
    guess = PressureStep().guess(state.moved(position, velocity))
    plain = PressureStep().guess(block())
    torch.testing.assert_close(guess.position.detach(), plain.position)
    along_position, along_velocity = torch.autograd.grad(
        guess.position.sum() + 3 * guess.velocity.sum(), (position, velocity)
    )
    torch.testing.assert_close(along_position, torch.ones_like(position))
    torch.testing.assert_close(along_velocity, torch.full_like(velocity, 3.02))


def test_the_slope_is_the_derivative_of_the_kernel() -> None:
    distance = torch.linspace(0.0, 0.25, 101, dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(cubic_spline(distance, 0.2).sum(), distance)
    torch.testing.assert_close(spline_slope(distance.detach(), 0.2), slope)


def test_a_solid_in_a_plane_counts_for_its_share() -> None:
    # Akinci et al. 2012: the denser the samples, the smaller the volume of each.
    volumes = []
    for count in (11, 21):
        grid = torch.cartesian_prod(*[torch.linspace(0, 1, count)] * 2)
        solids = torch.cat([grid, grid.new_zeros(len(grid), 1)], dim=1)
        state = Particles.single(torch.zeros(1, 3), torch.zeros(1, 3), solids, scene())
        volumes.append(solid_volumes(state).median())
    ratio = volumes[0] / volumes[1]
    assert 3.5 < float(ratio) < 4.5


@pytest.mark.parametrize(
    ("name", "value"),
    [("searches", 0), ("substeps", 0), ("sweeps", -1), ("solver_step", 0.0), ("warm_start", -1.0)],
)
def test_arguments_out_of_range_are_refused(name: str, value: float) -> None:
    with pytest.raises(UserError, match=rf"PressureStep: {name} is {value}"):
        PressureStep(**{name: value})


def test_it_predicts_the_solver_far_better_than_free_fall(sample: Path) -> None:
    reader = FrameReader(sample / "test.h5")
    prior = PressureStep(divergence_sweeps=0, sweeps=6)
    errors = []
    for frame in range(5, 35, 5):
        state, true = (reader.state("00000", it, stride=1) for it in (frame, frame + 1))
        errors.append(
            [
                (it.velocity - true.velocity).square().mean()
                for it in (prior(state), ballistic(state))
            ]
        )
    mine, free = torch.tensor(errors).mean(dim=0)
    assert mine < 0.2 * free


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"substeps": 2},
        {"searches": 1},
        {"substeps": 2, "divergence_sweeps": 0, "sweeps": 4},
        {"searches": 4, "substeps": 2, "time_step": 0.04},
        {"searches": 4, "time_step": 0.08},
    ],
)
def test_a_deep_pool_stays_at_rest(settings: dict[str, Any]) -> None:
    # Warm starts of 0.7 fit collisions better, and such a pool boils: 0.3 m/s.
    radius, layers, edge = 0.025, 19, 0.5
    where = Scene.single(
        (0.0, 0.0, 0.0), (edge, 1.0, edge), GRAVITY, radius, 4 * radius,
        settings.get("time_step", 0.02), viscosity=0.01,
    )  # fmt: skip
    columns = torch.arange(1, 10) * 2 * radius
    position = torch.cartesian_prod(columns, torch.arange(1, layers + 1) * 2 * radius, columns)
    side, height = torch.arange(-1, 22) * radius, torch.arange(-1, 42) * radius
    walls = torch.cartesian_prod(side, height, side)
    inside = (walls > 0).all(dim=1) & (walls < torch.tensor([edge, 1.0, edge])).all(dim=1)
    pool = Particles.single(position, torch.zeros_like(position), walls[~inside], where)
    prior = PressureStep(**{key: it for key, it in settings.items() if key != "time_step"})
    with torch.no_grad():
        for _ in range(150):
            guess = prior(pool)
            pool = pool.moved(guess.position, guess.velocity)
    speed = pool.velocity.square().sum(dim=1).mean().sqrt()
    # 1 % of the speed of a wave on shallow water.
    assert float(speed) < 0.01 * (9.81 * 2 * radius * layers) ** 0.5
    assert 0.85 < float(pool.position[:, 1].max()) < 1.0
