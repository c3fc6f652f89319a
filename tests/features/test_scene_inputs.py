"""Values of the scene as input of a network."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch

from fluidsnet.errors import UserError
from fluidsnet.features import NoGlobalFeature
from fluidsnet.features.scene_inputs import SceneInputs
from fluidsnet.model import Model
from fluidsnet.particles import Particles

LEAST = torch.tensor([0.0, -9.81, 0.0, 0.001, 0.0])
GREATEST = torch.tensor([0.0, -4.0, 0.0, 0.1, 0.0])


def inputs(*names: str) -> SceneInputs:
    found = SceneInputs(names)
    found.set_range(LEAST, GREATEST)
    return found


def with_values(particles: Particles, gravity: float, viscosity: list[float]) -> Particles:
    scene = particles.scene
    pull = scene.gravity * (gravity / -9.81)
    return replace(
        particles,
        scene=replace(scene, gravity=pull, viscosity=torch.tensor(viscosity, device=pull.device)),
    )


def test_columns_run_from_minus_one_to_one(make_particles: Callable[..., Particles]) -> None:
    state = with_values(make_particles((3, 0), (2, 0), (1, 0)), -4.0, [0.001, 0.01, 0.1])
    columns = inputs("viscosity").to(state.position.device)(state)
    assert columns.shape == (6, 1)
    low, middle, high = columns[[0, 3, 5], 0].tolist()
    assert low == pytest.approx(-1, abs=1e-5) and high == pytest.approx(1, abs=1e-5)
    # A decade each: logarithmic, not 0.82 below the middle.
    assert abs(middle) < 0.1
    pull = inputs("gravity").to(state.position.device)(state)
    assert pull.shape == (6, 3)
    assert pull[:, 1].tolist() == pytest.approx([1.0] * 6)


def test_one_frame_has_a_row_for_each_particle(make_particles: Callable[..., Particles]) -> None:
    state = with_values(make_particles((5, 2)), -9.81, [0.1])
    found = inputs("viscosity").to(state.position.device)(state)
    assert found.shape == (5, 1)


def test_a_scene_without_what_varies_has_no_column_and_the_same_weights() -> None:
    torch.manual_seed(0)
    plain = Model((2, 2, 2), global_feature=NoGlobalFeature)
    torch.manual_seed(0)
    constant = Model((2, 2, 2), global_feature=NoGlobalFeature, dimension=3, varying=[])
    assert plain.state_dict().keys() == constant.state_dict().keys()
    for name, value in plain.state_dict().items():
        assert torch.equal(value, constant.state_dict()[name]), name


def test_an_unknown_value_is_refused() -> None:
    with pytest.raises(UserError, match="no value 'color'; there are gravity, viscosity"):
        SceneInputs(["color"])
