"""A trained model in place of the solver, on each kind of scene."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import imageio_ffmpeg
import numpy as np
import pytest
import torch

from datamodules import read_state
from datamodules.generate.mesh import write_box
from datamodules.schema import SceneAttributes
from datamodules.start_file import start_header, write_start
from fluidsnet import load
from fluidsnet.export import read_field_data, read_frame
from fluidsnet.main import main
from fluidsnet.rollout import rollout
from fluidsnet.stress.cases import dam, pool
from fluidsnet.stress.scenes import Setting
from fluidsnet.studies.simulate.concerns import concerns, depth, greatest_speed
from fluidsnet.studies.simulate.rest import RestWatch

ROOT = Path(__file__).parents[2]
SETTING = Setting(0.025, 0.02)
needs_solver = pytest.mark.usefixtures("real_solver")

RECIPE = """
recipe:
  scene:
    class_path: datamodules.generate.{kind}
    init_args: {arguments}
  particle_radius: 0.05
  train: 1
  val: 0
  test: 1
  frames: 3
  frame_interval: 0.02
  solver: DFSPH
"""


def simulate(*arguments: object, model: str = "box_drops") -> None:
    main(["simulate", *map(str, arguments), f"--model={model}", "--device=cpu"])


def data_file(path: Path, height: float = 0.0) -> Path:
    """Write a data file of 600 particles at rest, some of them raised, m."""
    state = pool(SETTING, (10, 6, 10))
    position = state.position.numpy().copy()
    position[300:, 1] += height
    scene = state.scene
    attributes = SceneAttributes(
        domain_lower=tuple(scene.domain_lower[0].tolist()),
        domain_upper=tuple(scene.domain_upper[0].tolist()),
        gravity=(0.0, -9.81, 0.0),
        density0=1000.0,
        viscosity=0.01,
    )
    fluid = position, np.zeros_like(position)
    solids = state.solid_position.numpy()
    write_start(path, start_header("pool", 0.025, 0.02), attributes, fluid, solids, frames=2)
    return path


def config(folder: Path, kind: str, arguments: str) -> Path:
    path = folder / "kind.yaml"
    path.write_text(RECIPE.format(kind=kind, arguments=arguments))
    return path


def test_a_frame_of_a_data_file(
    sample: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = sample / "test.h5"
    simulate(
        path, "--frame=2", "--seconds=0.1", "--every=2", f"--output={tmp_path}",
        model="dam_break_small",
    )  # fmt: skip
    told = capsys.readouterr()
    made = tmp_path / "test_00000_2.vtkhdf"
    assert "frame 2 of /00000" in told.out and str(made) in told.out
    # The file has particles of 60 mm; the model is for 25 mm.
    assert "a radius of 0.06 m, and the model is for 0.025 m" in told.err
    # Each second step, and the last.
    assert read_field_data(made)["time"].tolist() == pytest.approx([0, 0.04, 0.08, 0.1])
    model = load("dam_break_small")
    start = read_state(path, read_state_interval(path), frame=2)
    start = replace(start, scene=replace(start.scene, time_step=0.02))
    states = [start, *rollout(model, start, 5)]
    for frame, step in enumerate((0, 2, 4, 5)):
        position, data = read_frame(made, frame)
        np.testing.assert_array_equal(position, states[step].position.numpy())
        np.testing.assert_array_equal(data["velocity"], states[step].velocity.numpy())
        np.testing.assert_allclose(data["speed"], states[step].velocity.norm(dim=1), rtol=1e-5)
    solids, _ = read_frame(tmp_path / "test_00000_2_solids.vtkhdf", 0)
    np.testing.assert_array_equal(solids, start.solid_position.numpy())
    assert (tmp_path / "test_00000_2.png").stat().st_size > 5_000


def read_state_interval(path: Path) -> float:
    with h5py.File(path) as file:
        return float(file.attrs["dt"])


def test_a_random_scene_on_lattices(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = config(tmp_path, "scenes.DamBreak", "{domain: [1.0, 0.8, 1.0]}")
    made = []
    for options in (("--simulation=1",), ("--simulation=1",), ("--seed=5",)):
        simulate(path, "--seconds=0.04", "--sampling=lattice", f"--output={tmp_path}", *options)
        told = capsys.readouterr().out
        assert "sampled by lattices" in told
        seed, number = (5, 0) if "seed" in options[0] else (0, 1)
        assert f"random scene {number} of seed {seed}" in told
        made.append(read_frame(tmp_path / f"kind_{seed}_{number}.vtkhdf", -1)[0])
    np.testing.assert_array_equal(made[0], made[1])
    assert made[0].shape != made[2].shape or not np.allclose(made[0], made[2])


def test_solids_of_a_random_scene_move(tmp_path: Path) -> None:
    path = config(tmp_path, "driven.StirredTank", "{speed: [3.0, 3.0]}")
    simulate(path, "--seconds=0.1", "--sampling=lattice", f"--output={tmp_path}")
    solids = tmp_path / "kind_0_0_solids.vtkhdf"
    (start, _), (end, data) = read_frame(solids, 0), read_frame(solids, -1)
    way = np.linalg.norm(end - start, axis=1)
    arm = np.linalg.norm((start - np.array([0.75, 0, 0.75]))[:, [0, 2]], axis=1)
    moved = way > 1e-4
    np.testing.assert_allclose(way[moved], 2 * arm[moved] * np.sin(0.15), rtol=1e-3)
    np.testing.assert_allclose(
        np.linalg.norm(data["velocity"][moved], axis=1), 3 * arm[moved], rtol=1e-3
    )
    assert 50 < moved.sum() < len(start) / 2 and not data["velocity"][~moved].any()


@pytest.fixture
def scene(tmp_path: Path) -> dict[str, Any]:
    """Return a scene with z up: a block of fluid in a box, whose mesh is in the folder."""
    write_box(tmp_path / "box.obj", (0.0, 0.0, 0.0), (0.8, 0.6, 1.0))
    return {
        "Configuration": {"particleRadius": 0.025, "gravitation": [0, 0, -9.81]},
        "Materials": [{"id": "Fluid", "viscosityMethod": 1, "Standard viscosity":
                       {"viscosity": 0.01}}],
        "RigidBodies": [{"geometryFile": "box.obj", "translation": [0, 0, 0], "isWall": True}],
        "FluidBlocks": [{"denseMode": 0, "start": [0.03, 0.03, 0.03], "end": [0.33, 0.53, 0.53]}],
    }  # fmt: skip


def write(folder: Path, scene: dict[str, Any]) -> Path:
    path = folder / "scene.json"
    path.write_text(json.dumps(scene))
    return path


@needs_solver
def test_a_scene_file_with_the_solver_and_a_movie(
    tmp_path: Path, scene: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    movie = tmp_path / "out" / "it.mp4"
    simulate(
        write(tmp_path, scene), "--seconds=0.2", "--every=2", f"--movie={movie}",
        f"--output={tmp_path}",
    )  # fmt: skip
    told = capsys.readouterr().out
    assert "sampled by the solver" in told and "The movie has 6 frames." in told
    position, _ = read_frame(tmp_path / "scene.vtkhdf", 0)
    end, _ = read_frame(tmp_path / "scene.vtkhdf", -1)
    assert len(position) == 5 * 9 * 9
    # It falls along z.
    assert end[:, 2].mean() < position[:, 2].mean() - 0.02 and np.isfinite(end).all()
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(movie))
    assert frames == 6 and seconds == pytest.approx(6 / 25, abs=0.02)


def test_a_scene_without_walls_may_fall_for_ever(tmp_path: Path, scene: dict[str, Any]) -> None:
    scene["RigidBodies"] = []
    simulate(write(tmp_path, scene), "--seconds=1", "--sampling=lattice", f"--output={tmp_path}")
    start, end = (read_frame(tmp_path / "scene.vtkhdf", step)[0] for step in (0, -1))
    fall = (start - end).mean(axis=0)
    np.testing.assert_allclose(fall, [0, 0, 9.81 / 2], rtol=0.03, atol=1e-3)


def test_a_pool_that_rests_ends_the_simulation(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = data_file(tmp_path / "pool.h5")
    simulate(path, "--seconds=20", "--until-rest", f"--output={tmp_path}")
    told = capsys.readouterr().out
    assert "The fluid rests: 99.9 % of it was slower than 0.074 m/s for 0.5 s up to" in told
    times = read_field_data(tmp_path / "pool_00000_0.vtkhdf")["time"]
    assert 0.5 <= times[-1] < 5
    simulate(
        path, "--seconds=0.6", "--until-rest", "--rest-speed=1e-5", f"--output={tmp_path / 'b'}"
    )
    assert "The fluid does not rest after 0.60 s" in capsys.readouterr().out


def test_rest_needs_half_a_second_without_a_splash() -> None:
    watch, slow = RestWatch(0.1), np.full(1000, 0.05)
    splash = np.where(np.arange(1000) < 20, 1.0, slow)
    assert not watch.at_rest(0.0, slow) and not watch.at_rest(0.4, slow)
    assert not watch.at_rest(0.45, splash) and not watch.at_rest(0.5, slow)
    assert not watch.at_rest(0.9, slow) and watch.at_rest(1.0, slow)
    # One drop in two thousand may run down a wall.
    drop = np.full(2000, 0.05)
    drop[0] = 1.0
    watch = RestWatch(0.1)
    assert not watch.at_rest(0.0, drop) and watch.at_rest(0.5, drop)


@pytest.mark.usefixtures("default_signals")
def test_ctrl_c_keeps_what_is_done(tmp_path: Path) -> None:
    path = data_file(tmp_path / "pool.h5")
    arguments = [path, "--model=box_drops", "--seconds=10000", f"--output={tmp_path / 'out'}"]
    process = subprocess.Popen(
        [sys.executable, "-m", "fluidsnet.main", "simulate", *map(str, arguments),
         f"--movie={tmp_path / 'it.mp4'}"],
        cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip
    partial = tmp_path / "out" / "pool_00000_0.vtkhdf.tmp"
    while process.poll() is None and not (partial.exists() and partial.stat().st_size > 120_000):
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    told, _ = process.communicate(timeout=300)
    assert process.returncode == 130, told
    assert "Interrupted: " in told and "are kept." in told and "fluidsnet: interrupted." in told
    made = partial.with_suffix("")
    times = read_field_data(made)["time"]
    assert len(times) > 2 and f"{len(times)} frames up to {times[-1]:.2f} s are kept" in told
    np.testing.assert_allclose(times, 0.02 * np.arange(len(times)))
    assert np.isfinite(read_frame(made, -1)[0]).all()
    assert {it.suffix for it in (tmp_path / "out").iterdir()} == {".vtkhdf", ".png"}
    assert not (tmp_path / "it.mp4").exists()


def test_a_run_and_what_is_kept_of_a_fluid_that_is_no_longer_finite(
    sample: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(ROOT)
    made, old = tmp_path / "test_00000_0.vtkhdf", ROOT / "tests" / "data" / "old_run"
    options = sample / "test.h5", "--seconds=0.08", f"--output={tmp_path}"
    simulate(*options, model=str(old))
    assert len(read_field_data(made)["time"]) == 5 and "WARNING" not in capsys.readouterr().err
    run = tmp_path / "run"
    shutil.copytree(old, run)
    checkpoint = run / "checkpoints" / "best.ckpt"
    content = torch.load(checkpoint, map_location="cpu", weights_only=True)
    # Its velocities overflow in the first step.
    content["state_dict"]["network.target.deviation"].fill_(3e38)
    content["state_dict"]["network.head.6.bias"].fill_(10)
    torch.save(content, checkpoint)
    with pytest.raises(SystemExit) as ended:
        simulate(*options, model=str(run))
    told = capsys.readouterr().err
    assert ended.value.code == 1 and "a particle is not finite after 0.02 s" in told
    assert str(made) in told and read_field_data(made)["time"].tolist() == [0]


def test_concerns() -> None:
    model = load("box_drops")
    assert concerns("box_drops", model, dam(SETTING)) == []
    assert depth(pool(SETTING, (12, 8, 12))) == pytest.approx(8 * 0.05, rel=0.01)
    deep = pool(SETTING, (4, 90, 4))
    (found,) = [it for it in concerns("box_drops", model, deep) if "deep" in it]
    assert "The water is 4.5 m deep, and the model was tried up to 4 m" in found
    start = dam(SETTING)
    fast = start.moved(start.position, start.velocity + torch.tensor([30.0, 0, 0]))
    assert greatest_speed(fast) == pytest.approx((900 + 2 * 9.81 * 0.52) ** 0.5, rel=0.01)
    assert "reaches 30 m/s" in concerns("box_drops", model, fast)[0]
    dense = start.moved(0.9 * start.position, start.velocity)
    assert any("starts compressed" in it for it in concerns("box_drops", model, dense))
    out = start.moved(start.position - torch.tensor([0.1, 0, 0]), start.velocity)
    told = "; ".join(concerns("box_drops", model, out))
    assert "100 of 1000 particles start outside" in told


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--seconds=0",), "--seconds is 0.0; set it above zero."),
        (("--seconds=0.001",), "--seconds is 0.001, less than the time step of box_drops, 0.02 s"),
        (("--every=0",), "--every is 0; set at least 1."),
        (("--rest-speed=1",), "--rest-speed is for --until-rest"),
        (("--device=abacus",), "--device is abacus; set cpu, cuda or auto."),
        (("--time-step=0.05",), "--time-step is 0.05 s, and box_drops steps by 0.02 s alone"),
        (("--movie=a.gif",), "a.gif: the name of a movie must end in .mp4."),
        (("--simulation=7",), "there is no simulation 7; it has 00000."),
        (("--frame=2",), "there is no frame 2 of /00000, which has 2."),
        (("--seed=1",), "--seed is for a config of random scenes"),
        (("--sampling=lattice",), "--sampling is for a scene that is not simulated yet"),
        (("--model=nowhere",), "nowhere is not the folder of a run"),
    ],
)
def test_options_that_cannot_be_used(
    tmp_path: Path,
    arguments: tuple[str, ...],
    message: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = data_file(tmp_path / "pool.h5")
    with pytest.raises(SystemExit) as ended:
        main(["simulate", str(path), "--model=box_drops", f"--output={tmp_path}", *arguments])
    assert ended.value.code == 1 and message in capsys.readouterr().err
    assert [it.name for it in tmp_path.iterdir()] == ["pool.h5"]


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_a_device_that_is_not_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = data_file(tmp_path / "pool.h5")
    with pytest.raises(SystemExit):
        main(["simulate", str(path), "--model=box_drops", "--device=cuda"])
    assert "PyTorch finds no CUDA device(s) here" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"Emitters": [{}]}, "the scene has 1 emitter(s), which no model steps"),
        ({"RigidBodies": [{"geometryFile": "box.obj", "isDynamic": True}]}, "dynamic rigid bodies"),
        ({"RigidBodies": [{"geometryFile": "box.obj", "isAnimated": True}]}, "whose motion is not"),
        ({"RigidBodies": [{"geometryFile": "none.obj"}]}, "none.obj is missing, which the scene"),
        ({"script": "a.py"}, "a.py, which only the solver can run; remove scriptFile"),
        ({"viscosity": 5.0}, "The fluid would burst apart: scene has a viscosity of 5"),
    ],
)
def test_scenes_that_no_model_steps(
    tmp_path: Path,
    scene: dict[str, Any],
    changes: dict[str, Any],
    message: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    if script := changes.pop("script", None):
        scene["Configuration"]["scriptFile"] = script
    if viscosity := changes.pop("viscosity", None):
        scene["Materials"][0]["Standard viscosity"]["viscosity"] = viscosity
    with pytest.raises(SystemExit) as ended:
        simulate(
            write(tmp_path, {**scene, **changes}),
            "--sampling=lattice",
            f"--output={tmp_path / 'o'}",
        )
    assert ended.value.code == 1 and message in capsys.readouterr().err
    assert not (tmp_path / "o").exists()


def test_a_config_that_is_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.yaml"
    for text, message in ((None, "there is no such file"), ("model: 1", "not a config of")):
        if text is not None:
            path.write_text(text)
        with pytest.raises(SystemExit):
            simulate(path)
        assert message in capsys.readouterr().err
