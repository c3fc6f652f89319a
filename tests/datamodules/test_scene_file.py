"""Data sets of scene files in SPlisHSPlasH's format, run by the real solver."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from datamodules.generate.command import generate_command
from datamodules.generate.dataset import generate
from datamodules.generate.mesh import write_box
from datamodules.generate.scene_file import SceneFile, package_scenes
from datamodules.generate.scene_file_plan import SceneFilePlan
from datamodules.inspection import summarize
from datamodules.reader import FrameReader
from datamodules.schema import Header, SceneAttributes, validate
from fluidsnet.errors import UserError

needs_solver = pytest.mark.usefixtures("real_solver")

RADIUS, EDGE = 0.05, 1.0
LOWER = (-0.5, 0.0, 2.0)


@pytest.fixture
def scene(tmp_path: Path) -> dict[str, Any]:
    """Return a scene of a block of fluid in a box, whose mesh is in the folder."""
    write_box(tmp_path / "box.obj", (0.0, 0.0, 0.0), (EDGE, EDGE, EDGE))
    return {
        "Configuration": {
            "particleRadius": RADIUS,
            "simulationMethod": 4,
            "gravitation": [0, -5, 0],
            "cflMethod": 1,
            "cflMaxTimeStepSize": 0.005,
            "boundaryHandlingMethod": 2,
            "enableZSort": True,
            "stopAt": 0.001,
            "DFSPH": {"maxError": 0.1, "maxIterations": 50},
        },
        "Materials": [
            {
                "id": "Fluid",
                "density0": 900,
                "viscosityMethod": 1,
                "Standard viscosity": {"viscosity": 0.03},
                "surfaceTensionMethod": 1,
                "Becker & Teschner 2007": {"surfaceTension": 0.2},
            }
        ],
        "RigidBodies": [body("box.obj", LOWER, isWall=True)],
        "FluidBlocks": [{"denseMode": 0, "start": [-0.4, 0.1, 2.1], "end": [0.0, 0.5, 2.5]}],
    }


def body(mesh: str, translation: tuple[float, float, float], **changes: Any) -> dict[str, Any]:
    return {
        "geometryFile": mesh,
        "translation": list(translation),
        "rotationAxis": [1, 0, 0],
        "rotationAngle": 0,
        "scale": [1, 1, 1],
        "isDynamic": False,
        "isWall": False,
        **changes,
    }


def write(folder: Path, scene: dict[str, Any]) -> str:
    path = folder / "scene.json"
    path.write_text(json.dumps(scene))
    return str(path)


def made(folder: Path, scene: dict[str, Any], frames: int = 6, **changes: Any) -> h5py.Group:
    """Generate the data set of a scene and return its simulation."""
    plan = SceneFilePlan(write(folder, scene), duration=0.02 * (frames - 1), **changes)
    assert generate(plan, folder / "data", processes=1) == []
    validate(folder / "data" / "test.h5")
    return h5py.File(folder / "data" / "test.h5")["00000"]


@needs_solver
def test_a_scene_is_stored_as_it_was_described(tmp_path: Path, scene: dict[str, Any]) -> None:
    group = made(tmp_path, scene)
    header, attributes = Header.read(group.file), SceneAttributes.read(group)
    assert (header.scene, header.solver, header.dt) == ("scene", "DFSPH", 0.02)
    assert header.particle_radius == RADIUS and header.support_radius == 4 * RADIUS
    assert header.solver_parameters["maxError"] == 0.1
    assert header.solver_parameters["timeStepSize"] == 0.0025
    assert attributes.gravity == (0, -5, 0) and attributes.density0 == 900
    assert (attributes.viscosity, attributes.surface_tension) == (0.03, 0.2)
    np.testing.assert_allclose(attributes.domain_lower, LOWER, atol=1e-6)
    np.testing.assert_allclose(attributes.domain_upper, np.add(LOWER, EDGE), atol=1e-6)
    np.testing.assert_allclose(group["time"], 0.02 * np.arange(6), rtol=1e-6)
    assert json.loads(group.attrs["scene_parameters"]) == scene
    fluid, solid = group["position"][:], group["solid_position"][:]
    assert fluid.shape == (6, 27, 3) and not group["velocity"][0].any()
    # It falls freely, as the block starts above the floor.
    fall = (fluid[0, :, 1] - fluid[1, :, 1]).mean()
    assert fall == pytest.approx(0.5625 * 5 * 0.02**2, rel=0.02)
    # The walls are in the planes of the box.
    to_plane = np.minimum(np.abs(solid - LOWER), np.abs(solid - np.add(LOWER, EDGE))).min(axis=1)
    assert len(solid) > 100 and to_plane.max() < 1e-5


@needs_solver
def test_a_network_can_read_it(tmp_path: Path, scene: dict[str, Any]) -> None:
    group = made(tmp_path, scene, frames=2)
    state = FrameReader(tmp_path / "data" / "test.h5").state("00000", 1, stride=1)
    np.testing.assert_array_equal(state.position.numpy(), group["position"][1])


@needs_solver
def test_without_walls_the_domain_holds_all_that_moved(
    tmp_path: Path, scene: dict[str, Any]
) -> None:
    scene["RigidBodies"] = []
    group = made(tmp_path, scene)
    attributes = SceneAttributes.read(group)
    assert group["solid_position"].shape == (0, 3)
    assert attributes.domain_lower[1] == pytest.approx(group["position"][-1, :, 1].min())
    assert attributes.domain_upper[1] == pytest.approx(group["position"][0, :, 1].max())


@needs_solver
def test_two_dimensions_are_stored_and_read(tmp_path: Path, scene: dict[str, Any]) -> None:
    scene["Configuration"]["sim2D"] = True
    scene["RigidBodies"][0]["translation"] = [-0.5, 0.0, -0.5]
    block = {"denseMode": 0, "start": [-0.4, 0.1, -0.5], "end": [0.0, 0.5, 0.5]}
    group = made(tmp_path, {**scene, "FluidBlocks": [block]}, frames=3)
    assert SceneAttributes.read(group).dimension == 2
    assert np.ptp(group["position"][:, :, 2]) == 0
    state = FrameReader(tmp_path / "data" / "test.h5").state("00000", 0, stride=1)
    assert state.scene.dimension == 2
    # The box is one particle deep, whatever the depth of the walls.
    assert state.scene.edges[0][2] == pytest.approx(2 * state.scene.particle_radius)
    assert state.scene.gravity[0, 2] == 0


SCRIPT = """
import splishsplash

def step():
    boundary = splishsplash.Simulation.getCurrent().getBoundaryModel(1)
    paddle = boundary.getRigidBodyObject()
    paddle.setVelocity([0.0, 0.5, 0.0])
    paddle.animate()
"""


@needs_solver
def test_an_animated_body_moves(tmp_path: Path, scene: dict[str, Any]) -> None:
    write_box(tmp_path / "paddle.obj", (0.0, 0.0, 0.0), (0.2, 0.2, 0.2))
    scene["RigidBodies"].append(body("paddle.obj", (0.2, 0.2, 2.6), isAnimated=True))
    (tmp_path / "paddle.py").write_text(SCRIPT)
    with pytest.raises(UserError, match=r"no scriptFile that moves it"):
        SceneFilePlan(write(tmp_path, scene))
    scene["Configuration"]["scriptFile"] = "paddle.py"
    with pytest.raises(UserError, match=r"runs the Python script .*paddle\.py.*--run-script"):
        SceneFilePlan(write(tmp_path, scene))
    group = made(tmp_path, scene, run_script=True)
    position, velocity = group["solid_position"][:], group["solid_velocity"][:]
    assert position.shape == velocity.shape and position.shape[0] == 6
    moved = np.ptp(position, axis=0).max(axis=1) > 0
    assert 0 < moved.sum() < len(moved)
    travel = position[-1, moved] - position[0, moved]
    np.testing.assert_allclose(travel, [[0, 0.05, 0]] * moved.sum(), atol=1e-3)
    np.testing.assert_allclose(velocity[-1, moved], [[0, 0.5, 0]] * moved.sum(), atol=1e-4)
    assert re.search(r"solids +move", summarize(tmp_path / "data" / "test.h5").text)


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "emitter": ({"Emitters": [{"width": 1}]}, r"1 emitter\(s\)"),
    "phases": (
        {"FluidBlocks": [{"id": "Oil", "start": [0] * 3, "end": [1] * 3}, {"start": [0] * 3}]},
        r"several phases \(Fluid, Oil\)",
    ),
    "elastic": ({"Materials": [{"id": "Fluid", "elasticityMethod": 1}]}, "elastic bodies"),
    "dynamic": ({"RigidBodies": [{"isDynamic": True}]}, "dynamic rigid bodies"),
    "fields": ({"AnimationFields": [{"shapeType": 0}]}, "animation fields"),
    "no fluid": ({"FluidBlocks": []}, "no fluid"),
    "solver": ({"Configuration": {"simulationMethod": 99}}, "an unknown pressure solver"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_represented_is_refused_by_name(
    tmp_path: Path, scene: dict[str, Any], case: str
) -> None:
    changes, expected = REFUSED[case]
    with pytest.raises(UserError, match=rf"scene\.json: the scene has {expected}"):
        SceneFilePlan(write(tmp_path, {**scene, **changes}))


@pytest.mark.parametrize(
    ("text", "expected"),
    [("{", "not a scene in JSON"), ("[]", "no section Configuration"), ("{}", "Configuration")],
)
def test_a_file_that_is_no_scene_is_refused(tmp_path: Path, text: str, expected: str) -> None:
    (tmp_path / "scene.json").write_text(text)
    with pytest.raises(UserError, match=rf"scene\.json: .*{expected}"):
        SceneFilePlan(str(tmp_path / "scene.json"))


@pytest.mark.parametrize("name", ["duration", "frame_interval"])
def test_times_are_above_zero(tmp_path: Path, scene: dict[str, Any], name: str) -> None:
    for value in (0.0, -1.0, float("inf"), float("nan")):
        with pytest.raises(UserError, match=f"{name} is {value}; it must be above zero"):
            SceneFilePlan(write(tmp_path, scene), **{name: value})
    with pytest.raises(UserError, match="shorter than frame_interval"):
        SceneFilePlan(write(tmp_path, scene), duration=0.001)


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"cflMethod": 0, "timeStepSize": 0.004}, 0.004),
        ({"cflMethod": 1, "timeStepSize": 0.004}, 0.0025),
        ({"cflMethod": 1, "timeStepSize": 0.001}, 0.001),
        ({"cflMethod": 1, "cflMaxTimeStepSize": 0.002}, 0.002),
        ({"cflMethod": 0, "timeStepSize": 0.003}, 0.02 / 7),
        ({"cflMethod": 1, "simulationMethod": 0}, 0.0005),
    ],
)
def test_the_time_step_is_fixed_and_divides_the_interval(
    tmp_path: Path, scene: dict[str, Any], settings: dict[str, Any], expected: float
) -> None:
    scene["Configuration"].update(settings)
    (job,) = SceneFilePlan(write(tmp_path, scene)).jobs(tmp_path, threads=1).values()
    assert job.solver_step == pytest.approx(expected)
    assert job.steps_per_frame * job.solver_step == pytest.approx(0.02)


@needs_solver
def test_a_scene_of_the_package_is_found_by_its_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert len(package_scenes()) > 40
    for name in ("DoubleDamBreak", "DoubleDamBreak.json"):
        assert SceneFile.find(name).path.is_file()
    with pytest.raises(UserError, match=r"Nothing\.json: there is no such scene file.*Scenes"):
        SceneFile.find("Nothing.json")
    root = tmp_path / "double"
    arguments = ["--scene-file=DoubleDamBreak.json", "--root", str(root), "--duration", "0.02"]
    generate_command(arguments)
    printed = capsys.readouterr().out
    assert "run by DFSPH with a fixed time step of 2.5 ms and walls of particles" in printed
    assert SceneAttributes.read(h5py.File(root / "test.h5")["00000"]).domain_upper[1] > 3
    before = (root / "test.h5").stat().st_mtime_ns
    generate_command(arguments)
    with pytest.raises(UserError, match="holds data of another recipe"):
        generate_command([*arguments, "--frame-interval", "0.01"])
    assert (root / "test.h5").stat().st_mtime_ns == before
