"""Tests of the data generator, with the real solver in tiny scenes."""

from __future__ import annotations

import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from datamodules.generate.bodies import Block, Drop
from datamodules.generate.dataset import generate
from datamodules.generate.job import DrawnJob, SolverName, scene_file
from datamodules.generate.recipe import Recipe
from datamodules.generate.recorder import EscapedError, Recorder
from datamodules.generate.scenes import CLEARANCE, DamBreak, DrawnScene, DropPool, SceneKind
from datamodules.schema import Header, SceneAttributes, validate
from fluidsnet.errors import UserError

needs_solver = pytest.mark.usefixtures("real_solver")

EDGE, RADIUS, INTERVAL = 1.0, 0.08, 0.01
DOMAIN = (EDGE, EDGE, EDGE)

RECIPE = Recipe(
    scene=DamBreak(DOMAIN),
    particle_radius=RADIUS,
    train=2,
    val=0,
    test=0,
    frames=41,
    frame_interval=INTERVAL,
)

OCTAHEDRON = """# an octahedron
v 1 0 0
v -1 0 0
v 0 1 0
v 0 -1 0
v 0 0 1
v 0 0 -1
f 1 3 5
f 3 2 5
f 2 4 5
f 4 1 5
f 3 1 6
f 2 3 6
f 4 2 6
f 1 4 6
"""


@dataclass(frozen=True)
class Simulation:
    """Group of a file, in memory."""

    header: Header
    position: NDArray[np.float32]
    velocity: NDArray[np.float32]
    time: NDArray[np.float64]
    seconds: NDArray[np.float64]
    solid: NDArray[np.float32]
    attributes: dict[str, Any]


def read(path: Path) -> list[Simulation]:
    validate(path)
    with h5py.File(path) as file:
        return [
            Simulation(
                Header.read(file),
                *(
                    group[name][()]
                    for name in ("position", "velocity", "time", "solver_seconds", "solid_position")
                ),
                dict(group.attrs),
            )
            for group in file.values()
        ]


def by_place(position: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the points sorted by coordinates."""
    rounded = np.round(position.astype(np.float64), 5)
    return rounded[np.lexsort(rounded.T)]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, real_solver: None) -> Path:
    root = tmp_path_factory.mktemp("made") / "dam"
    assert generate(RECIPE, root, processes=2) == []
    return root


@pytest.fixture(scope="module")
def simulations(made: Path) -> list[Simulation]:
    return read(made / "train.h5")


@needs_solver
def test_what_was_asked_for_is_there_and_nothing_else(made: Path) -> None:
    # A split of no simulation is no file.
    assert {path.name for path in made.iterdir()} == {"recipe.json", "train.h5"}
    validate(made / "train.h5")
    with h5py.File(made / "train.h5") as file:
        header = Header.read(file)
        scenes = [SceneAttributes.read(group) for group in file.values()]
        assert list(file) == ["00000", "00001"]
        assert all(len(group["time"]) == RECIPE.frames for group in file.values())
    assert (header.scene, header.solver, header.dt) == ("DamBreak", "IISPH", INTERVAL)
    for scene in scenes:
        assert (scene.domain_lower, scene.domain_upper) == ((0.0, 0.0, 0.0), DOMAIN)
        assert (scene.gravity, scene.viscosity) == (RECIPE.gravity, RECIPE.viscosity)
    assert header.support_radius == pytest.approx(4 * RADIUS)
    assert header.solver_parameters["timeStepSize"] == 0.0025


@needs_solver
def test_frames_lie_exactly_on_time(simulations: list[Simulation]) -> None:
    for simulation in simulations:
        np.testing.assert_allclose(
            simulation.time, INTERVAL * np.arange(RECIPE.frames), rtol=1e-12, atol=0
        )


@needs_solver
def test_a_row_keeps_its_particle(simulations: list[Simulation]) -> None:
    for simulation in simulations:
        moved = np.diff(simulation.position.astype(np.float64), axis=0)
        mean = (simulation.velocity[1:] + simulation.velocity[:-1]) / 2
        off = np.linalg.norm(moved - INTERVAL * mean, axis=-1)
        assert np.median(off) < 0.02 * RADIUS
        assert off.max() < RADIUS, "another particle is two radii away"


@needs_solver
def test_the_fluid_falls_as_gravity_says(simulations: list[Simulation]) -> None:
    # A start that is too dense at the walls bursts apart instead, at several meters a second.
    for simulation in simulations:
        speed = np.linalg.norm(simulation.velocity, axis=-1)
        fall = 9.81 * simulation.time
        assert (speed[1:4].max(axis=1) < 2.5 * fall[1:4]).all()
        potential = 9.81 * simulation.position[..., 1].astype(np.float64)
        kinetic = 0.5 * speed.astype(np.float64) ** 2
        energy = (potential + kinetic).mean(axis=1)
        assert (energy < 1.05 * energy[0]).all()


@needs_solver
def test_the_first_frame_is_the_drawn_body_at_rest(simulations: list[Simulation]) -> None:
    for number, simulation in enumerate(simulations):
        assert not simulation.velocity[0].any()
        seed = json.loads(simulation.attributes["seed"])
        assert seed == [0, 0, number]
        (block,) = RECIPE.starts()["train", number].bodies
        assert json.loads(simulation.attributes["scene_parameters"])[0]["shape"] == "block"
        assert isinstance(block, Block)
        layers = np.round(np.subtract(block.upper, block.lower) / (2 * RADIUS)).astype(int)
        grid = np.stack(np.meshgrid(*map(np.arange, layers), indexing="ij"), -1).reshape(-1, 3)
        expected = np.array(block.lower) + RADIUS * (2 * grid + 1)
        np.testing.assert_allclose(
            by_place(simulation.position[0]), by_place(expected), atol=2e-5, rtol=0
        )


@needs_solver
def test_fluid_keeps_its_clearance_at_the_start_and_stays_inside(
    simulations: list[Simulation],
) -> None:
    for simulation in simulations:
        start = simulation.position[0]
        clear = (1 + CLEARANCE) * RADIUS - 1e-5
        assert (start > clear).all() and (start < EDGE - clear).all()
        assert (simulation.position > -RADIUS).all()
        assert (simulation.position < EDGE + RADIUS).all()


@needs_solver
def test_solids_lie_on_all_six_walls(simulations: list[Simulation]) -> None:
    for simulation in simulations:
        solid = simulation.solid
        at_lower, at_upper = np.isclose(solid, 0, atol=1e-6), np.isclose(solid, EDGE, atol=1e-6)
        assert (at_lower | at_upper).any(axis=1).all()
        assert (solid > -1e-6).all() and (solid < EDGE + 1e-6).all()
        for wall in (*at_lower.T, *at_upper.T):
            # No hole that a particle fits through.
            assert wall.sum() > (EDGE / (2 * RADIUS)) ** 2


@needs_solver
def test_the_solvers_seconds_are_kept_for_each_frame(simulations: list[Simulation]) -> None:
    for simulation in simulations:
        assert simulation.seconds[0] == 0
        assert (simulation.seconds[1:] > 0).all()
        assert simulation.seconds.sum() < 60
        assert simulation.attributes["threads"] == 1


@needs_solver
def test_one_seed_one_data_set(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # A folder named from where one is, as in the README, is made there.
    monkeypatch.chdir(tmp_path)
    generate(replace(RECIPE, train=1, frames=21), Path("again"), processes=1)
    again, first = read(tmp_path / "again" / "train.h5")[0], read(made / "train.h5")[0]
    # 200 ms: enough for the splash to differ, were there any chance in it.
    np.testing.assert_array_equal(again.position, first.position[:21])
    np.testing.assert_array_equal(again.velocity, first.velocity[:21])
    assert replace(RECIPE, seed=1).starts() != RECIPE.starts() == RECIPE.starts()


@needs_solver
@pytest.mark.parametrize("solver", ["WCSPH", "PCISPH", "DFSPH"])
def test_each_solver_runs_by_one_word(
    solver: SolverName, tmp_path: Path, simulations: list[Simulation]
) -> None:
    recipe = replace(RECIPE, train=1, solver=solver)
    assert generate(recipe, tmp_path, processes=1) == []
    (simulation,) = read(tmp_path / "train.h5")
    assert simulation.header.solver == solver
    assert simulation.header.solver_parameters["timeStepSize"] == recipe.step
    assert np.isfinite(simulation.position).all() and np.isfinite(simulation.velocity).all()
    assert (simulation.position > -RADIUS).all()
    assert (simulation.position < EDGE + RADIUS).all()
    # Still fluid on a floor, and the same fluid as IISPH's.
    assert simulation.position[-1, :, 1].mean() > RADIUS
    reference = simulations[0].position.mean(axis=1)
    np.testing.assert_allclose(simulation.position.mean(axis=1), reference, atol=RADIUS)
    speed = np.linalg.norm(simulation.velocity, axis=-1)
    assert speed.max() < 3 * np.sqrt(2 * 9.81 * EDGE)


@needs_solver
def test_a_mesh_may_be_the_drop(tmp_path: Path) -> None:
    mesh = tmp_path / "drop.obj"
    mesh.write_text(OCTAHEDRON)
    domain = (1.0, 1.4, 1.0)
    kind = DropPool(domain, radius=(0.28, 0.28), mesh=mesh)
    radius = 0.05
    recipe = replace(RECIPE, scene=kind, particle_radius=radius, train=1, frames=11)
    assert generate(recipe, tmp_path / "data", processes=1) == []
    (simulation,) = read(tmp_path / "data" / "train.h5")
    pool, drop = kind.sample(np.random.default_rng([0, 0, 0]), radius).bodies
    assert isinstance(drop, Drop)
    start = simulation.position[0].astype(np.float64)
    above = start[start[:, 1] > pool.bounds()[1][1]] - np.array(drop.center)
    # |x| + |y| + |z| is at most the radius inside an octahedron, and not in a ball.
    assert len(above) > 10
    assert np.abs(above).sum(axis=1).max() < drop.radius + 2 * radius
    assert np.linalg.norm(above, axis=1).max() <= drop.radius + 1e-3
    assert len(above) < len(start)


class Spoiled(DamBreak):
    """Dam break in which some simulations have an octahedron with a hole in it."""

    def __init__(self, mesh: Path, always: bool = False) -> None:
        super().__init__(DOMAIN)
        self.mesh, self.always = mesh, always
        self._drawn = 0

    def sample(self, random: np.random.Generator, particle_radius: float) -> DrawnScene:
        self._drawn += 1
        if self.always or self._drawn == 2:
            drop = Drop((0.5, random.uniform(0.4, 0.6), 0.5), 0.3, str(self.mesh))
            return DrawnScene(DOMAIN, [drop])
        return super().sample(random, particle_radius)


@needs_solver
def test_a_failure_is_named_with_its_seed_and_the_others_go_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mesh = tmp_path / "open.obj"
    mesh.write_text("\n".join(OCTAHEDRON.splitlines()[:-1]))
    recipe = replace(RECIPE, scene=Spoiled(mesh), frames=3, seed=5, train=3)
    failures = generate(recipe, tmp_path / "data", processes=2)
    assert [(failure.name, failure.seed) for failure in failures] == [("train-00001", [5, 0, 1])]
    assert "open.obj" in failures[0].reason and "open" in failures[0].reason
    said = capsys.readouterr().err
    assert "train-00001" in said and "[5, 0, 1]" in said and "left out" in said
    with h5py.File(tmp_path / "data" / "train.h5") as file:
        assert list(file) == ["00000", "00002"]
    assert not (tmp_path / "data" / "parts").exists()


@needs_solver
def test_a_split_of_which_nothing_is_left_is_an_error(tmp_path: Path) -> None:
    scene = Spoiled(tmp_path / "nowhere.obj", always=True)
    recipe = replace(RECIPE, scene=scene, frames=3, train=2)
    with pytest.raises(UserError, match=r"train\.h5 would be empty: .*2 .* failed.*nowhere\.obj"):
        generate(recipe, tmp_path / "data", processes=2)
    assert not (tmp_path / "data" / "train.h5").exists()


@needs_solver
def test_a_data_set_of_an_old_recipe_is_still_accepted(sample: Path, tmp_path: Path) -> None:
    # The note of the sample was written before scenes had boxes of their own.
    root = tmp_path / "dam_break"
    shutil.copytree(sample, root)
    recipe = Recipe(
        scene=DamBreak((1.5, 1.0, 1.5)),
        particle_radius=0.06,
        train=3,
        val=1,
        test=1,
        frames=41,
        frame_interval=0.02,
    )
    assert generate(recipe, root) == []
    assert (root / "recipe.json").read_bytes() == (sample / "recipe.json").read_bytes()


@needs_solver
def test_another_recipe_leaves_the_folder_alone(made: Path) -> None:
    before = (made / "train.h5").stat().st_mtime_ns
    for other in (replace(RECIPE, seed=1), replace(RECIPE, scene=DamBreak((1.0, 1.0, 1.5)))):
        with pytest.raises(UserError, match="another recipe"):
            generate(other, made)
    # The same recipe again has nothing to do.
    assert generate(RECIPE, made) == []
    assert (made / "train.h5").stat().st_mtime_ns == before


@pytest.mark.parametrize("name", ["processes", "threads"])
@pytest.mark.parametrize("value", [0, -1])
def test_less_than_one_process_or_thread_is_an_error(tmp_path: Path, name: str, value: int) -> None:
    with pytest.raises(UserError, match=f"--{name} is {value}"):
        generate(RECIPE, tmp_path / "data", **{name: value})
    assert not (tmp_path / "data").exists()


@needs_solver
def test_files_of_unknown_origin_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "val.h5").write_bytes(b"precious")
    with pytest.raises(UserError, match="already holds data"):
        generate(RECIPE, tmp_path)
    assert (tmp_path / "val.h5").read_bytes() == b"precious"


SCRIPT = f"""
import sys
from pathlib import Path
from datamodules.generate.bodies import Block, Drop
from datamodules.generate.dataset import generate
from datamodules.generate.recipe import Recipe
from datamodules.generate.scenes import DamBreak
recipe = Recipe(scene=DamBreak({DOMAIN}), particle_radius={RADIUS}, train=2, val=1, test=0,
                frames={{frames}}, frame_interval={INTERVAL})
generate(recipe, Path(sys.argv[1]), processes=1)
"""


@needs_solver
def test_a_killed_run_is_taken_up_where_it_was(tmp_path: Path) -> None:
    root, frames = tmp_path / "data", 200
    command = [sys.executable, "-c", SCRIPT.format(frames=frames), str(root)]
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    run = subprocess.Popen(
        command,
        start_new_session=True,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "TMPDIR": str(scratch)},
    )
    first = root / "parts" / "train-00000.h5"
    unfinished: list[Path] = []
    deadline = time.monotonic() + 300
    # Until the first simulation is whole and the second is under way.
    while not (first.exists() and unfinished):
        assert run.poll() is None, "it ended before it could be killed"
        assert time.monotonic() < deadline
        time.sleep(0.01)
        unfinished = list(root.glob("parts/train-00001*.tmp"))
    os.killpg(run.pid, signal.SIGKILL)
    run.wait()
    assert list(root.glob("parts/*.tmp")), "something is left half-written"
    assert not list(root.glob("*.h5"))
    assert not list(scratch.iterdir()), "nothing is left where nobody looks"
    validate(first)
    before = (first.stat().st_mtime_ns, first.stat().st_ino)

    recipe = replace(RECIPE, val=1, frames=frames)
    seen: list[tuple[int, int]] = []
    join = Path.replace

    def watched(self: Path, target: Path) -> Path:
        # The parts are still there when the first whole file gets its name.
        if first.exists():
            seen.append((first.stat().st_mtime_ns, first.stat().st_ino))
        return join(self, target)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Path, "replace", watched)
        assert generate(recipe, root, processes=2) == []
    assert seen and set(seen) == {before}
    assert {path.name for path in root.iterdir()} == {"recipe.json", "train.h5", "val.h5"}
    for split, number in (("train", 2), ("val", 1)):
        whole = read(root / f"{split}.h5")
        assert [len(simulation.time) for simulation in whole] == [frames] * number


@needs_solver
def test_the_solvers_process_imports_neither_torch_nor_lightning() -> None:
    # It starts once a simulation, and these would take longer than a short simulation.
    words = (
        "import sys, datamodules.generate.solver; "
        "print([name for name in ('torch', 'lightning') if name in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


def job(tmp_path: Path, **changes: Any) -> DrawnJob:
    recipe = replace(RECIPE, frames=3, **changes)
    return recipe.job("train", 0, recipe.starts()["train", 0], tmp_path / "part.h5", 1)


class FakeSolver:
    """Two particles whose buffer has room for a third, in place of pysplishsplash."""

    def __init__(self) -> None:
        self.position = np.full((3, 3), 0.5, dtype=np.float32)
        self.velocity = np.zeros((3, 3), dtype=np.float32)
        self.now = 0.0
        self.set: list[float] = []
        fluid = SimpleNamespace(
            getFieldBuffer=lambda name: getattr(self, name), numActiveParticles=lambda: 2
        )
        wall = SimpleNamespace(numberOfParticles=lambda: 1, getPosition=lambda row: [0.0, 0.0, 0.0])
        simulation = SimpleNamespace(
            numberOfFluidModels=lambda: 1,
            getFluidModel=lambda number: fluid,
            numberOfBoundaryModels=lambda: 1,
            getBoundaryModel=lambda number: wall,
        )
        self.Simulation = SimpleNamespace(getCurrent=lambda: simulation)
        clock = SimpleNamespace(getTime=lambda: self.now, setTime=self.set.append)
        self.TimeManager = SimpleNamespace(getCurrent=lambda: clock)


@pytest.fixture
def recorder(tmp_path: Path) -> Any:
    """Return a recorder of frames of four steps of 2.5 ms, and its solver."""
    solver = FakeSolver()
    read_end, write_end = os.pipe()
    with h5py.File(tmp_path / "part.h5", "w") as file:
        yield Recorder(solver, job(tmp_path), file.create_group("00000"), write_end), solver  # type: ignore[arg-type]
    os.close(read_end)
    os.close(write_end)


def step(recorder: Recorder, solver: FakeSolver, steps: int) -> None:
    for _ in range(steps):
        solver.now = 0.0025 * (len(solver.set) + 1)
        recorder.step(0.5)


def test_a_frame_is_every_so_many_steps_of_active_particles(recorder: Any) -> None:
    record, solver = recorder
    step(record, solver, 4)
    solver.position[:2] = 0.25
    step(record, solver, 4)
    record.finish()
    assert record.position.shape == (3, 2, 3)
    assert record.position[:, 0, 0].tolist() == [0.5, 0.5, 0.25]
    assert record.group["time"][()].tolist() == pytest.approx([0, 0.01, 0.02])
    # The solver's seconds for the four steps of a frame, and nothing else.
    assert record.group["solver_seconds"][()].tolist() == [0, 2, 2]


def test_a_particle_leaves_the_box_of_its_own_simulation(tmp_path: Path) -> None:
    solver = FakeSolver()
    read_end, write_end = os.pipe()
    made = job(tmp_path)
    wider = replace(made.scene, domain_lower=(-1.0, 0.0, 0.0), domain_upper=(2 * EDGE, EDGE, EDGE))
    with h5py.File(tmp_path / "part.h5", "w") as file:
        group = file.create_group("00000")
        record = Recorder(solver, replace(made, scene=wider), group, write_end)  # type: ignore[arg-type]
        solver.position[0, 0], solver.position[1, 0] = -1.0, 2 * EDGE
        step(record, solver, 4)
        solver.position[1, 0] += 1.1 * RADIUS
        with pytest.raises(EscapedError, match="1 of 2 particles left"):
            step(record, solver, 4)
    os.close(read_end)
    os.close(write_end)


@pytest.mark.parametrize("place", [-1.1 * RADIUS, EDGE + 1.1 * RADIUS])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_particle_that_left_is_found(recorder: Any, place: float, axis: int) -> None:
    record, solver = recorder
    step(record, solver, 4)
    solver.position[1, axis] = place
    with pytest.raises(EscapedError, match="1 of 2 particles left through a wall by frame 2"):
        step(record, solver, 4)


def test_a_particle_within_a_radius_of_the_wall_has_not_left(recorder: Any) -> None:
    record, solver = recorder
    solver.position[1, 1] = -0.9 * RADIUS
    solver.position[2] = 99  # beyond the active ones
    step(record, solver, 8)
    record.finish()


@pytest.mark.parametrize("name", ["position", "velocity"])
def test_what_is_not_finite_is_found(recorder: Any, name: str) -> None:
    record, solver = recorder
    getattr(solver, name)[0, 2] = np.nan
    with pytest.raises(RuntimeError, match="not finite in frame 1"):
        step(record, solver, 4)


def test_a_step_of_another_length_is_found(recorder: Any) -> None:
    record, solver = recorder
    step(record, solver, 2)
    solver.now += 0.0031
    with pytest.raises(RuntimeError, match=r"step 3 ends at 0\.0075 s"):
        record.step(0.0)


def test_the_solvers_clock_does_not_drift(recorder: Any) -> None:
    # A sum in single precision would be off by a hundredth of a step before the 1,500th.
    record, solver = recorder
    for _ in range(1500):
        start = np.float32(solver.set[-1] if solver.set else 0.0)
        solver.now = float(start + np.float32(0.0025))
        record.step(0.0)
    assert solver.set[-1] == pytest.approx(3.75, abs=1e-9)


@pytest.mark.parametrize(
    ("solver", "step"), [("IISPH", 0.0025), ("DFSPH", 0.0025), ("PCISPH", 0.0025), ("WCSPH", 5e-4)]
)
def test_each_solver_has_its_own_step(solver: SolverName, step: float, tmp_path: Path) -> None:
    made = job(tmp_path, solver=solver)
    assert made.solver_step == step
    assert made.steps_per_frame == round(INTERVAL / step)
    assert job(tmp_path, solver=solver, solver_step=0.005).steps_per_frame == 2


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"frame_interval": 0.004}, "frame_interval .0.004 s. must be a whole number"),
        ({"frame_interval": 0.001}, "whole number of solver steps .0.0025 s."),
        ({"solver_step": 0.003}, "whole number of solver steps .0.003 s."),
        ({"solver_step": 0.0}, "solver_step is 0.0"),
        ({"solver_step": -0.0025}, "solver_step is -0.0025"),
        ({"frame_interval": 0.0011, "solver": "WCSPH"}, "solver steps .0.0005 s."),
        ({"frames": 1}, "frames is 1"),
        ({"particle_radius": 0.0}, "particle_radius is 0.0"),
        ({"viscosity": -1.0}, "viscosity is -1.0; it must be at least zero"),
        ({"density0": 0.0}, "density0 is 0.0; it must be above zero"),
        ({"solver_parameters": {"maxIteration": 5}}, "has maxIteration, which IISPH does not know"),
        ({"solver_parameters": {"maxError": -1.0}}, "maxError is -1.0; it must be at least zero"),
        (
            {"solver_parameters": {"maxError": math.nan}},
            "maxError is nan; it must be",
        ),
        ({"gravity": (0.0, math.nan, 0.0)}, "they must be finite"),
        ({"frame_interval": math.nan}, "they must be finite"),
        ({"seed": -1}, "seed is -1; it must be at least 0"),
        ({"train": -1}, "train is -1"),
        ({"val": -2}, "val is -2"),
        ({"train": 0}, "train, val and test are all zero"),
    ],
)
def test_a_recipe_that_cannot_be_is_an_error(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(UserError, match=words):
        replace(RECIPE, **changes)


def test_particles_that_no_solver_counts_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"particles fit into a box of .* Set larger particles"):
        job(tmp_path, particle_radius=1e-5)


def test_a_recipes_own_parameters_reach_the_solver(tmp_path: Path) -> None:
    made = job(tmp_path, solver_parameters={"maxError": 0.01})
    assert made.parameters == {"maxIterations": 100, "maxError": 0.01}
    assert scene_file(made, tmp_path)["Configuration"]["IISPH"] == made.parameters


def test_a_job_comes_back_from_its_text(tmp_path: Path) -> None:
    kind: SceneKind = DropPool(DOMAIN, mesh=tmp_path / "drop.obj")
    made = job(tmp_path, scene=kind, particle_radius=0.05)
    values = json.loads(made.to_json())
    assert values.pop("kind") == "DrawnJob"
    back = DrawnJob.from_values(values)
    assert back.to_json() == made.to_json()
    assert [type(body) for body in back.bodies] == [Block, Drop]
