"""Scenes that differ in gravity, viscosity or dimension: made, trained on, refused elsewhere."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch

import fluidsnet
from datamodules import SPHDataModule, read_state
from datamodules.augmentation import BoxSymmetry
from datamodules.generate.box_drops import BoxDrops
from datamodules.generate.dam_break_2d import DamBreak2D
from datamodules.generate.dataset import generate
from datamodules.generate.recipe import Recipe
from datamodules.generate.scenes import SceneKind
from datamodules.generate.tilted_box import TiltedBox
from fluidsnet.errors import UserError
from fluidsnet.main import main
from fluidsnet.metrics.density import Density
from fluidsnet.particles import Particles
from fluidsnet.priors import PressureStep
from fluidsnet.rollout import rollout

CONFIGS = Path(__file__).parents[2] / "configs"
RADIUS, FRAMES = 0.05, 9
KINDS: dict[str, SceneKind] = {
    "tilted": TiltedBox(domain=(1.0, 0.8, 1.0)),
    "viscous": BoxDrops(
        width=(1.0, 1.0), height=(1.2, 1.2), depth=(1.0, 1.0), bodies=(1, 1), volume=(0.2, 0.25),
        viscosity=(0.001, 0.1),
    ),
    "flat": DamBreak2D(domain=(2.0, 1.6)),
}  # fmt: skip
VARYING = {"tilted": ["gravity"], "viscous": ["viscosity"], "flat": []}


@pytest.fixture(scope="module")
def roots(tmp_path_factory: pytest.TempPathFactory, real_solver: None) -> dict[str, Path]:
    roots = {}
    for name, kind in KINDS.items():
        recipe = Recipe(
            scene=kind, particle_radius=RADIUS, train=2, val=1, test=1, frames=FRAMES,
            frame_interval=0.02, solver="DFSPH",
        )  # fmt: skip
        roots[name] = tmp_path_factory.mktemp("data") / name
        assert generate(recipe, roots[name], processes=1) == []
    return roots


def module(root: Path) -> SPHDataModule:
    return SPHDataModule(root, voxel_size=0.25, batch_size=2)


def fit(root: Path, model: str, logs: Path) -> Path:
    arguments = [
        "fit", "--config", str(CONFIGS / "trainer.yaml"),
        "--config", str(CONFIGS / "model" / f"{model}.yaml"), "--data", "datamodules.SPHDataModule",
        "--data.init_args.root", str(root), "--data.init_args.voxel_size", "0.25",
        "--data.init_args.batch_size", "2", "--trainer.max_epochs", "1",
        "--trainer.logger.init_args.save_dir", str(logs),
    ]  # fmt: skip
    main(arguments)
    return logs / "fluidsnet" / "version_0"


@pytest.mark.parametrize("kind", KINDS)
def test_the_data_module_says_what_varies(roots: dict[str, Path], kind: str) -> None:
    data = module(roots[kind])
    assert data.varying == VARYING[kind]
    assert data.dimension == (2 if kind == "flat" else 3)
    assert (data.grid_shape[2] == 1) == (kind == "flat")


def test_gravity_is_oblique_and_that_of_the_file(roots: dict[str, Path]) -> None:
    with h5py.File(roots["tilted"] / "train.h5") as file:
        pulls = np.array([file[name].attrs["gravity"] for name in file])
        velocity = file["00000/velocity"][1]
    assert np.abs(pulls[0] - pulls[1]).max() > 0.1
    tilts = np.degrees(np.arccos(-pulls[:, 1] / np.linalg.norm(pulls, axis=1)))
    assert ((tilts >= 5) & (tilts <= 30)).all()
    # After one frame the free surface is in free fall along the horizontal part of gravity.
    top = velocity[:, [0, 2]].mean(axis=0)
    assert top @ pulls[0, [0, 2]] > 0


def test_a_flat_scene_stays_in_its_plane_at_rest_density(roots: dict[str, Path]) -> None:
    state = read_state(roots["flat"] / "test.h5", 0.02, frame=4)
    assert state.scene.dimension == 2 and not state.position[:, 2].any()
    # The solver's own sum, with the kernel and the volumes of two dimensions.
    assert float(Density()(state).median()) == pytest.approx(1, abs=0.01)
    errors = {}
    for name, model in {"flat": state, "as if in space": as_if_in_space(state)}.items():
        step = PressureStep()(model)
        true = read_state(roots["flat"] / "test.h5", 0.02, frame=5)
        errors[name] = float((step.position - true.position).norm(dim=1).mean())
    assert errors["flat"] < 0.5 * errors["as if in space"]


def as_if_in_space(state: Particles) -> Particles:
    return replace(state, scene=replace(state.scene, dimension=3))


@pytest.mark.parametrize("model", ["paper", "corrected"])
@pytest.mark.parametrize("kind", KINDS)
def test_networks_train_on_them_and_come_back(
    roots: dict[str, Path], kind: str, model: str, tmp_path: Path
) -> None:
    run = fit(roots[kind], model, tmp_path)
    network = fluidsnet.load(run)
    # The prior knows gravity and viscosity; the paper's network has none.
    columns = {"tilted": 3, "viscous": 1, "flat": 0}[kind] if model == "paper" else 0
    assert network.network.scene_inputs.width == columns
    last = [it for it in network.network.head.modules() if isinstance(it, torch.nn.Linear)][-1]
    outputs = {"paper": 3, "corrected": 6}[model]
    assert last.out_features == (outputs if kind != "flat" else outputs * 2 // 3)
    state = read_state(roots[kind] / "test.h5", network.time_step)
    for after in rollout(network, state, 3):
        assert after.position.isfinite().all()
    if kind == "flat":
        assert not after.position[:, 2].any() and not after.velocity[:, 2].any()
    main(["test", "--run", str(run)])
    assert list((run / "results").rglob("one_step.csv"))


@pytest.fixture(scope="module")
def tilted_run(roots: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fit(roots["tilted"], "paper", tmp_path_factory.mktemp("runs"))


def changed(root: Path, folder: Path, **attributes: object) -> Path:
    """Return a copy of the test split alone, with other attributes of its simulation."""
    folder.mkdir()
    shutil.copy(root / "test.h5", folder / "test.h5")
    with h5py.File(folder / "test.h5", "r+") as file:
        file["00000"].attrs.update(attributes)
    return folder


def measure(run: Path, root: Path) -> None:
    main(["test", "--run", str(run), "--data.init_args.root", str(root)])


def test_what_was_constant_is_refused_where_it_differs(
    roots: dict[str, Path], tilted_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        measure(tilted_run, changed(roots["tilted"], tmp_path / "a", viscosity=0.05))
    assert "viscosity is 0.05, and this network was trained at 0.01 alone" in (
        capsys.readouterr().err
    )
    with pytest.raises(SystemExit):
        measure(tilted_run, changed(roots["tilted"], tmp_path / "b", surface_tension=0.2))
    assert "surface tension is 0.2, and this network was trained at 0 alone" in (
        capsys.readouterr().err
    )


def test_what_varied_may_differ_with_a_warning(
    roots: dict[str, Path], tilted_run: Path, tmp_path: Path
) -> None:
    # Without a training split, what varies is known from the checkpoint.
    with pytest.warns(UserWarning, match=r"gravity is \(0, -30, 0\), outside the range"):
        measure(tilted_run, changed(roots["tilted"], tmp_path / "a", gravity=[0.0, -30.0, 0.0]))


def test_other_dimensions_are_refused(
    roots: dict[str, Path], tilted_run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        measure(tilted_run, roots["flat"])
    assert "trained in 3 dimensions" in capsys.readouterr().err


def test_a_rollout_in_python_is_checked_too(roots: dict[str, Path], tilted_run: Path) -> None:
    network = fluidsnet.load(tilted_run)
    state = read_state(roots["viscous"] / "test.h5", network.time_step)
    with pytest.raises(UserError, match=r"test/00000: viscosity is .* trained at 0.01 alone"):
        next(rollout(network, state, 1))


def test_a_prior_alone_says_what_it_leaves_out(roots: dict[str, Path], tmp_path: Path) -> None:
    model = fluidsnet.load("box_drops")
    root = changed(roots["viscous"], tmp_path / "a", surface_tension=0.5)
    state = read_state(root / "test.h5", model.time_step)
    with pytest.warns(UserWarning, match=r"surface tension of 0.5, which the prior PressureStep"):
        next(rollout(model, state, 1))


def test_flat_samples_are_mirrored_in_their_plane(roots: dict[str, Path]) -> None:
    data = SPHDataModule(roots["flat"], voxel_size=0.25, batch_size=4, augmentation=BoxSymmetry())
    data.setup("fit")
    batches = list(data.train_dataloader())
    assert not any(batch.state.position[:, 2].any() for batch in batches)
    assert not any(batch.next_velocity[..., 2].any() for batch in batches)


@pytest.mark.parametrize(
    "settings", [{"tilt": (20.0, 10.0)}, {"tilt": (0.0, 91.0)}, {"gravity": (-1.0, 5.0)}]
)
def test_ranges_that_are_not_possible_are_refused(settings: dict[str, tuple[float, float]]) -> None:
    with pytest.raises(UserError, match="of TiltedBox"):
        TiltedBox(**settings)
