"""Properties of a step over generated scenes of any box, resolution and count."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor, nn

from datamodules.augmentation import BoxSymmetry
from fluidsnet.features import KernelMessages, NoGlobalFeature, VoxelField
from fluidsnet.integrator import Displacement, Trapezoid
from fluidsnet.kernels import disabled
from fluidsnet.metrics.density import Density
from fluidsnet.metrics.positions import escaped
from fluidsnet.model import Model
from fluidsnet.models import load
from fluidsnet.neighbors import Auto, BruteForce, CellList, TorchCluster
from fluidsnet.particles import Particles, Transitions
from fluidsnet.scene import Scene
from fluidsnet.statistics import Statistics
from fluidsnet.target import AccelerationTarget, DisplacementTarget
from fluidsnet.walls import StopAtWalls

#: More than a generated frame has particles, so that none is cut off the neighbors.
K = 256
GRID = (5, 4, 3)
#: Positions are multiples of this, m, so that a shift by multiples of it is exact in float32.
UNIT = 2.0**-14

MODELS: dict[str, Callable[[], Model]] = {
    "paper": lambda: Model(GRID, Auto(K)),
    "no global feature": lambda: Model(
        GRID, CellList(K), global_feature=NoGlobalFeature, target=AccelerationTarget(),
        integrator=Trapezoid(),
    ),
    "field": lambda: Model(
        GRID, TorchCluster(K), local=KernelMessages(8), global_feature=VoxelField,
        target=DisplacementTarget(), integrator=Displacement(), walls=StopAtWalls(),
    ),
}  # fmt: skip


def statistics(scale: float = 1.0) -> Statistics:
    """Return statistics of data whose lengths are scaled: the drift is in support radii."""
    mean, change = torch.tensor([0.1, -0.5, 0.2]), torch.tensor([0.0, -0.1, 0.02])
    deviations = torch.tensor([0.7, 0.2, 0.02])
    return Statistics(
        scale * mean, scale * deviations[0], scale * change, scale * deviations[1], deviations[2]
    )


def trained(name: str, scale: float = 1.0) -> Model:
    """Return a model with random weights, and running means that are not their defaults."""
    torch.manual_seed(0)
    model = MODELS[name]()
    for module in model.modules():
        if isinstance(module, nn.BatchNorm1d):
            module.running_mean.uniform_(-0.5, 0.5)
            module.running_var.uniform_(0.5, 2.0)
    model.set_statistics(statistics(scale), time_step=0.02)
    return model.eval()


@dataclass
class Numbers:
    """Numbers that make a frame; kept apart from it for messages that can be read."""

    edges: tuple[float, float, float]
    corner: tuple[float, float, float]
    gravity: tuple[float, float, float]
    radius: float
    fluid: int
    solid: int
    spread: float
    seed: int

    def frame(self) -> Particles:
        """Return a frame: fluid somewhere in the box, solids in it and on its walls."""
        random = torch.Generator().manual_seed(self.seed)
        corner, edges = torch.tensor(self.corner), torch.tensor(self.edges)
        middle = torch.rand(3, generator=random)
        inside = torch.rand(self.fluid, 3, generator=random)
        fluid = middle + self.spread * (inside - middle)
        solid = torch.rand(self.solid, 3, generator=random)
        solid[::2, self.seed % 3] = solid[::2, self.seed % 3].round()
        position, walls = (
            ((corner + place * edges) / UNIT).round() * UNIT for place in (fluid, solid)
        )
        velocity = torch.randn(self.fluid, 3, generator=random)
        upper = [low + edge for low, edge in zip(self.corner, self.edges, strict=True)]
        scene = Scene.single(
            self.corner, upper, self.gravity, self.radius, 4 * self.radius, 0.02,
            name=f"seed {self.seed}",
        )  # fmt: skip
        return Particles.single(position, velocity, walls, scene)


def _steps(low: float, high: float, unit: float) -> st.SearchStrategy[float]:
    """Multiples of a unit, which are exact in float32."""
    return st.integers(round(low / unit), round(high / unit)).map(lambda count: count * unit)


def numbers(radius: float | None = None, fluid: int = 1) -> st.SearchStrategy[Numbers]:
    """Generate frames of at least so many fluid particles, of one resolution or any."""
    edge, coordinate = _steps(0.25, 4.0, 0.25), _steps(-3.0, 3.0, 0.25)
    pull = st.floats(-10.0, 10.0, width=32)
    return st.builds(
        Numbers,
        edges=st.tuples(edge, edge, edge),
        corner=st.tuples(coordinate, coordinate, coordinate),
        gravity=st.tuples(pull, pull, pull),
        radius=_steps(1 / 64, 1 / 4, 1 / 64) if radius is None else st.just(radius),
        fluid=st.integers(fluid, 60),
        solid=st.one_of(st.just(0), st.integers(1, 80)),
        spread=st.sampled_from([0.05, 0.3, 1.0]),
        seed=st.integers(0, 2**16),
    )


generated = settings(max_examples=25, deadline=None, derandomize=True)
models = pytest.mark.parametrize("name", MODELS)


def assert_close(found: Particles, expected: Particles, atol: float = 2e-5) -> None:
    torch.testing.assert_close(found.position, expected.position, atol=atol, rtol=1e-4)
    torch.testing.assert_close(found.velocity, expected.velocity, atol=atol, rtol=1e-4)


@models
@given(numbers())
@generated
def test_permuted_particles_step_to_permuted_states(name: str, drawn: Numbers) -> None:
    frame, model = drawn.frame(), trained(name)
    order, solids = torch.randperm(drawn.fluid), torch.randperm(drawn.solid)
    permuted = replace(
        frame,
        position=frame.position[order],
        velocity=frame.velocity[order],
        solid_position=frame.solid_position[solids],
    )
    with torch.no_grad():
        after = model.step(frame)
        assert_close(
            model.step(permuted), after.moved(after.position[order], after.velocity[order])
        )


@models
@given(numbers(), st.tuples(*[_steps(-4.0, 4.0, 0.25)] * 3))
@generated
def test_a_translated_scene_steps_to_the_translated_state(
    name: str, drawn: Numbers, shift: tuple[float, float, float]
) -> None:
    frame, model, by = drawn.frame(), trained(name), torch.tensor(shift)
    scene = frame.scene
    moved = replace(
        frame,
        position=frame.position + by,
        solid_position=frame.solid_position + by,
        scene=replace(
            scene, domain_lower=scene.domain_lower + by, domain_upper=scene.domain_upper + by
        ),
    )
    with torch.no_grad():
        after = model.step(frame)
        assert_close(model.step(moved), after.moved(after.position + by, after.velocity))


@models
@given(numbers(), st.sampled_from([0.125, 0.5, 4.0, 1024.0]))
@generated
def test_a_scaled_scene_with_scaled_velocities_steps_to_the_scaled_state(
    name: str, drawn: Numbers, scale: float
) -> None:
    frame = drawn.frame()
    scene = frame.scene
    scaled = replace(
        frame,
        position=scale * frame.position,
        velocity=scale * frame.velocity,
        solid_position=scale * frame.solid_position,
        scene=replace(
            scene,
            domain_lower=scale * scene.domain_lower,
            domain_upper=scale * scene.domain_upper,
            gravity=scale * scene.gravity,
            particle_radius=scale * scene.particle_radius,
            support_radius=scale * scene.support_radius,
            edges=tuple(tuple(scale * edge for edge in edges) for edges in scene.edges),
        ),
    )
    with torch.no_grad():
        after = trained(name).step(frame)
        found = trained(name, scale).step(scaled)
    assert_close(found.moved(found.position / scale, found.velocity / scale), after)


@models
@given(st.lists(numbers(radius=1 / 16, fluid=0), min_size=2, max_size=4))
@generated
def test_a_mixed_batch_steps_as_its_frames_alone(name: str, drawn: list[Numbers]) -> None:
    if name == "paper":
        # Its grid is bound to one box; gravity, corners and counts may differ.
        drawn = [replace(each, edges=drawn[0].edges) for each in drawn]
    frames, model = [each.frame() for each in drawn], trained(name)
    batch = Particles.collate(frames)
    assert [len(scene) for scene in (batch.scene, frames[0].scene)] == [len(drawn), 1]
    with torch.no_grad():
        after, alone = model.step(batch), [model.step(frame) for frame in frames]
    assert_close(after, Particles.collate(alone))
    assert torch.equal(after.frame, batch.frame)


@models
@given(numbers())
@generated
def test_solids_out_of_reach_change_nothing(name: str, drawn: Numbers) -> None:
    frame, model = drawn.frame(), trained(name)
    limit = frame.scene.support_radius
    distance = torch.cdist(frame.position.double(), frame.solid_position.double())
    near = distance.min(dim=0).values <= 1.001 * limit
    random = torch.Generator().manual_seed(drawn.seed)
    far = frame.position.mean(dim=0) + 20 + torch.randn(30, 3, generator=random)
    places = torch.cat([far[:10], frame.solid_position, far[10:]])
    more, fewer = (
        Particles.single(frame.position, frame.velocity, solids, frame.scene)
        for solids in (places, frame.solid_position[near])
    )
    with torch.no_grad():
        after = model.step(frame)
        for other in (more, fewer):
            assert_close(model.step(other), after, atol=1e-6)


@given(numbers(), st.sampled_from([0, 1, 2]))
@generated
def test_all_searches_find_the_same_neighbors(drawn: Numbers, which: int) -> None:
    frame = drawn.frame()
    search = (CellList, Auto, TorchCluster)[which](K)
    distance = torch.cdist(
        frame.position.double(), torch.cat([frame.position, frame.solid_position]).double()
    )
    if ((distance - frame.scene.support_radius).abs() < 1e-6).any():
        return  # a neighbor at the very cutoff may be in or out
    found, expected = search(frame), BruteForce(K)(frame)
    pairs = [
        set(zip(it.particle.tolist(), it.neighbor.tolist(), strict=True))
        for it in (found, expected)
    ]
    assert pairs[0] == pairs[1]


def degenerate(drawn: Numbers, extent: tuple[int, int, int], shift: float) -> Particles:
    """Return a frame whose fluid is a point, a line or a sheet, half of it twice, and solids on it.

    Args:
        drawn: Frame to change.
        extent: Axes along which the fluid is spread.
        shift: Edges of the box by which the fluid is moved along x.
    """
    frame = drawn.frame()
    place = frame.position[0] + (frame.position - frame.position[0]) * torch.tensor(extent)
    place[: len(place) // 2] = place[len(place) - len(place) // 2 :].clone()
    solid = frame.solid_position.clone()
    reached = min(len(solid), len(place))
    solid[:reached] = place[:reached]
    place[:, 0] += shift * drawn.edges[0]
    return replace(frame, position=place, solid_position=solid)


clouds = given(
    numbers(radius=0.025),
    st.sampled_from([(0, 0, 0), (1, 0, 0), (1, 0, 1)]),
    st.sampled_from([0.0, 2.0]),
)


@models
@clouds
@generated
def test_degenerate_clouds_step_to_the_same_state_by_kernels_and_torch(
    name: str, drawn: Numbers, extent: tuple[int, int, int], shift: float
) -> None:
    frame, model = degenerate(drawn, extent, shift), trained(name)
    found = model.step(frame)
    assert found.position.isfinite().all() and found.velocity.isfinite().all()
    with disabled():
        assert_close(found, model.step(frame), atol=1e-4)


@clouds
@generated
def test_degenerate_clouds_stay_finite_in_the_pressure_step(
    drawn: Numbers, extent: tuple[int, int, int], shift: float
) -> None:
    model, state = load("box_drops"), degenerate(drawn, extent, shift)
    for _ in range(3):
        state = model.step(state)
    assert state.position.isfinite().all() and state.velocity.isfinite().all()


@given(numbers(), st.integers(0, 2))
@generated
def test_free_fall_walls_density_and_escaped_in_a_mirror(drawn: Numbers, axis: int) -> None:
    model = Model(
        GRID, Auto(K), global_feature=NoGlobalFeature, target=DisplacementTarget(),
        integrator=Displacement(), walls=StopAtWalls(),
    ).eval()  # fmt: skip
    for weight in model.network.head.parameters():
        nn.init.zeros_(weight)
    frame = drawn.frame()
    mirrored = _mirrored(frame, axis)
    with torch.no_grad():
        after, image = model.step(frame), model.step(mirrored)
    assert_close(image, _mirrored(after, axis))
    lower, upper = frame.scene.domain_lower, frame.scene.domain_upper
    assert ((after.position >= lower) & (after.position <= upper)).all()
    for measure in (escaped, Density()):
        torch.testing.assert_close(measure(mirrored), measure(frame), atol=1e-5, rtol=1e-5)


def _mirrored(frame: Particles, axis: int) -> Particles:
    """Return a frame in a mirror through the middle of its box."""
    sign = torch.ones(3)
    sign[axis] = -1
    scene = frame.scene
    middle = (scene.domain_lower + scene.domain_upper) / 2
    place: Callable[[Tensor], Tensor] = lambda position: (position - middle) * sign + middle  # noqa: E731
    return replace(
        frame,
        position=place(frame.position),
        velocity=sign * frame.velocity,
        solid_position=place(frame.solid_position),
        scene=replace(scene, gravity=sign * scene.gravity),
    )


@given(numbers())
@generated
def test_an_augmented_sample_falls_as_it_did(drawn: Numbers) -> None:
    frame = replace(drawn, gravity=(0.0, -9.81, 0.0)).frame()
    step, gravity = frame.scene.time_step, frame.scene.gravity
    after = frame.position + step * frame.velocity + step**2 / 2 * gravity
    sample = Transitions(
        frame, after[None], (frame.velocity + step * gravity)[None], torch.zeros(1)
    )
    torch.manual_seed(drawn.seed)
    turned = BoxSymmetry()(sample)
    state = turned.state
    torch.testing.assert_close(
        turned.next_position[0], state.position + step * state.velocity + step**2 / 2 * gravity,
        atol=1e-5, rtol=1e-5,
    )  # fmt: skip
    torch.testing.assert_close(turned.next_velocity[0], state.velocity + step * gravity)
    assert float(escaped(state)) == pytest.approx(float(escaped(frame)), abs=1e-6)


def test_generated_frames_hold_what_they_should() -> None:
    drawn = Numbers((1.0, 2.0, 0.5), (-1.0, 0.0, 3.0), (0.0, -9.81, 0.0), 1 / 16, 40, 60, 1.0, 7)
    frame = drawn.frame()
    lower, upper = frame.scene.domain_lower, frame.scene.domain_upper
    both = torch.cat([frame.position, frame.solid_position])
    assert ((both >= lower - UNIT) & (both <= upper + UNIT)).all()
    assert torch.equal(both / UNIT, (both / UNIT).round())
