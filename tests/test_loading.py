"""Trained models come back from the folder of a run, also of an earlier version."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from lightning import Trainer
from test_module import data, trainer

import fluidsnet
from callbacks import Ablation
from datamodules import read_state
from fluidsnet import FluidsNet
from fluidsnet.checkpoint_migration import migrate
from fluidsnet.errors import UserError
from fluidsnet.features import NoGlobalFeature, VoxelField
from fluidsnet.models import shipped_models
from fluidsnet.particles import Particles
from fluidsnet.priors import PressureStep
from fluidsnet.rollout import rollout
from fluidsnet.target import AccelerationTarget, DisplacementTarget, PriorAlone

#: Trained by the version before models were kept side by side; `step.npz` is its prediction.
OLD = Path(__file__).parent / "data" / "old_run"


def state(sample: Path, device: torch.device) -> Particles:
    return read_state(sample / "test.h5", 0.02, frame=5).to(device)


def test_an_old_run_predicts_what_it_did(sample: Path, device: torch.device) -> None:
    model = fluidsnet.load(OLD, device)
    after = model.step(state(sample, device))
    assert not after.position.requires_grad
    expected = np.load(OLD / "step.npz")
    np.testing.assert_allclose(after.position.cpu(), expected["position"], atol=1e-5)
    np.testing.assert_allclose(after.velocity.cpu(), expected["velocity"], atol=1e-4)
    states = list(rollout(model, state(sample, device), 3))
    assert torch.equal(states[0].position, after.position)
    assert torch.equal(states[1].position, model.step(after).position)


def test_a_prior_alone_is_loaded_from_its_config(sample: Path, device: torch.device) -> None:
    configs = Path(__file__).parents[1] / "configs" / "model"
    model = fluidsnet.load(configs / "prior.yaml", device)
    before = state(sample, device)
    assert torch.equal(model.step(before).position, model.prior(before).position)
    # Arguments of the prior in place of the config's, checked as there.
    coarse = fluidsnet.load(configs / "prior.yaml", device, prior={"searches": 1, "substeps": 2})
    expected = PressureStep(searches=1, substeps=2).to(device)(before)
    assert torch.equal(coarse.step(before).position, expected.position)
    with pytest.raises(UserError, match=r"searches is 0; set at least 1"):
        fluidsnet.load(configs / "prior.yaml", prior={"searches": 0})
    with pytest.raises(UserError, match=r"the prior of a trained network cannot be changed"):
        fluidsnet.load(OLD, prior={"searches": 1})
    with pytest.raises(UserError, match=r"corrected.yaml describes a network without weights"):
        fluidsnet.load(configs / "corrected.yaml")
    with pytest.raises(UserError, match=r"missing.yaml holds no `model:`"):
        fluidsnet.load("missing.yaml")


@pytest.mark.parametrize("name", shipped_models())
def test_a_shipped_model_is_loaded_by_its_name(name: str, device: torch.device) -> None:
    model = fluidsnet.load(name, device)
    folder = Path(fluidsnet.models.__file__).parent / name
    assert model.is_trained and "## Limits" in (folder / "card.md").read_text()
    interval = 0.02 if name.startswith("box_drops") else 0.0025
    described = yaml.safe_load((folder / "config.yaml").read_text())
    stride = described["data"]["init_args"]["stride"]
    assert float(model.time_step) == pytest.approx(stride * interval)
    assert described["trainer"]["logger"]["init_args"]["name"] == name


def test_a_shipped_model_steps_only_by_its_time_step(sample: Path, device: torch.device) -> None:
    model = fluidsnet.load("dam_break_small", device)
    before = read_state(sample / "test.h5", model.time_step, frame=5).to(device)
    assert torch.equal(model.step(before).position, model.prior(before).position)
    finer = fluidsnet.load("box_drops", device, prior={"substeps": 3})
    assert (finer.prior.searches, finer.prior.substeps) == (3, 3)
    with pytest.raises(UserError, match=r"prior is set for a time step of 0.04 s, and the data"):
        next(iter(rollout(fluidsnet.load("box_drops_40ms", device), before, 1)))
    with pytest.raises(UserError, match=r"time_step is -0.02; set seconds"):
        PriorAlone(-0.02)


def test_a_name_that_is_no_run_lists_the_shipped_models(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"config.yaml is missing. These models ship .* box_drops,"):
        fluidsnet.load("box_drop")
    # A run that ended before its first checkpoint.
    shutil.copy(OLD / "config.yaml", tmp_path)
    with pytest.raises(UserError, match=r"last.ckpt is missing. A training writes it at its first"):
        fluidsnet.load(tmp_path)


def with_twins(grid_shape: tuple[int, int, int]) -> tuple[FluidsNet, list[Ablation]]:
    return FluidsNet(grid_shape), [
        Ablation("target", AccelerationTarget(), "acceleration"),
        Ablation("global_feature", NoGlobalFeature, "no_global_feature"),
    ]


def test_an_old_training_with_twins_is_resumed(sample: Path, tmp_path: Path) -> None:
    source = data(sample, voxel_size=0.125)
    module, ablations = with_twins(source.grid_shape)
    path = OLD / "checkpoints" / "best.ckpt"
    before = torch.load(path, weights_only=True)
    runner = trainer(tmp_path, max_epochs=2, limit_train_batches=4, limit_val_batches=1,
                     callbacks=[*ablations])  # fmt: skip
    runner.fit(module, source, ckpt_path=path, weights_only=True)
    assert runner.global_step == 2 * before["global_step"]
    for name in ("model", "acceleration", "no_global_feature"):
        prefix = "" if name == "model" else f"twins.{name}."
        bias = before["state_dict"][f"{prefix}network.head.0.bias"]
        now = module.named_models()[name].state_dict()["network.head.0.bias"].cpu()
        assert 0 < float((now - bias).abs().max()) < 0.1


def test_migration_leaves_a_checkpoint_of_this_version_alone(sample: Path, tmp_path: Path) -> None:
    source = data(sample)
    runner: Trainer = trainer(tmp_path, max_steps=1, limit_val_batches=1)
    runner.fit(FluidsNet(source.grid_shape), source)
    runner.save_checkpoint(tmp_path / "new.ckpt")
    checkpoint = torch.load(tmp_path / "new.ckpt", weights_only=True)
    names = list(checkpoint["state_dict"])
    migrate(checkpoint)
    assert list(checkpoint["state_dict"]) == names


@pytest.mark.parametrize("owner", ["model", "twin"])
def test_a_field_that_covered_the_domain_is_refused(
    owner: str, sample: Path, tmp_path: Path
) -> None:
    source = data(sample)
    blocks = {"global_feature": VoxelField} if owner == "model" else {}
    twins = [] if owner == "model" else [Ablation("global_feature", VoxelField, "twin")]
    module, path = FluidsNet(source.grid_shape, **blocks), tmp_path / "old.ckpt"
    runner = trainer(tmp_path, max_steps=1, limit_val_batches=1, callbacks=twins)
    runner.fit(module, source)
    runner.save_checkpoint(path)
    checkpoint = torch.load(path, weights_only=True)
    weights = checkpoint["state_dict"]
    for name, value in weights.items():
        if name.startswith(f"models.{owner}.network.global_feature.") and value.ndim == 3:
            weights[name] = value.view(3, 3, 3, *value.shape[1:]).permute(4, 3, 2, 1, 0)
    torch.save(checkpoint, path)
    message = r"global_feature VoxelField .* covered the whole domain.*: train the network again"
    if owner == "model":
        with pytest.raises(UserError, match=message):
            FluidsNet.load_from_checkpoint(path, **blocks)
        with pytest.raises(UserError, match=message):
            trainer(tmp_path).test(module, source, ckpt_path=path, verbose=False)
    else:
        # Left out, it does no harm.
        FluidsNet.load_from_checkpoint(path)
        with pytest.raises(UserError, match=message):
            runner.fit(module, source, ckpt_path=path)


def test_a_displacement_in_meters_is_refused(sample: Path, tmp_path: Path) -> None:
    source, path = data(sample), tmp_path / "old.ckpt"
    blocks = {"global_feature": NoGlobalFeature, "target": DisplacementTarget()}
    runner = trainer(tmp_path, max_steps=1, limit_val_batches=1)
    runner.fit(FluidsNet(source.grid_shape, **blocks), source)
    runner.save_checkpoint(path)
    checkpoint = torch.load(path, weights_only=True)
    weights, target = checkpoint["state_dict"], "models.model.network.target."
    radii = weights.pop(f"{target}drift_radii")
    weights[f"{target}drift_deviation"] = 0.24 * radii
    torch.save(checkpoint, path)
    with pytest.raises(UserError, match=r"target DisplacementTarget .* in m, .*drift_deviation.*"):
        FluidsNet.load_from_checkpoint(path, **blocks)
    # As the message says.
    weights[f"{target}drift_radii"] = weights.pop(f"{target}drift_deviation") / 0.24
    torch.save(checkpoint, path)
    again = FluidsNet.load_from_checkpoint(path, **blocks)
    assert torch.allclose(again.model.network.target.drift_radii.cpu(), radii.cpu())


def test_lightning_loads_an_old_checkpoint() -> None:
    path = OLD / "checkpoints" / "best.ckpt"
    module = FluidsNet.load_from_checkpoint(path)
    expected = fluidsnet.load(OLD).state_dict()
    for name, value in module.model.state_dict().items():
        assert torch.equal(value.cpu(), expected[name]), name


def test_a_checkpoint_without_a_note_of_its_blocks_is_migrated(tmp_path: Path) -> None:
    shutil.copytree(OLD, tmp_path / "run")
    path = tmp_path / "run" / "checkpoints" / "best.ckpt"
    checkpoint = torch.load(path, weights_only=True)
    del checkpoint["fluidsnet_blocks"], checkpoint["fluidsnet_twins"]
    weights = checkpoint["state_dict"]
    checkpoint["state_dict"] = {n: weights[n] for n in weights if not n.startswith("twins.")}
    torch.save(checkpoint, path)
    expected = fluidsnet.load(OLD).state_dict()
    for name, value in fluidsnet.load(tmp_path / "run").state_dict().items():
        assert torch.equal(value, expected[name]), name


def test_a_damaged_checkpoint_and_one_of_other_shapes_are_refused(tmp_path: Path) -> None:
    shutil.copytree(OLD, tmp_path / "run")
    config = tmp_path / "run" / "config.yaml"
    config.write_text(config.read_text().replace("hidden: 7", "hidden: 8"))
    with pytest.raises(UserError, match=r"do not fit model.local"):
        fluidsnet.load(tmp_path / "run")
    path = tmp_path / "run" / "checkpoints" / "best.ckpt"
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(UserError, match=r"best.ckpt cannot be read; it is damaged"):
        fluidsnet.load(tmp_path / "run")


def test_a_state_of_another_time_step_is_not_rolled_out(sample: Path) -> None:
    other = read_state(sample / "test.h5", 0.04)
    with pytest.raises(UserError, match=r"time step of 0.02 s, and the data .* 0.04 s"):
        next(rollout(fluidsnet.load(OLD), other, 1))


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"not the folder of a run: .*config.yaml is missing"):
        fluidsnet.load(tmp_path)
    shutil.copy(OLD / "config.yaml", tmp_path)
    with pytest.raises(UserError, match=r"has no weights: .*last.ckpt is missing"):
        fluidsnet.load(tmp_path)
    shutil.copytree(OLD / "checkpoints", tmp_path / "checkpoints")
    (tmp_path / "config.yaml").write_text("seed_everything: 0")
    with pytest.raises(UserError, match=r"config.yaml holds no `model:`"):
        fluidsnet.load(tmp_path)
    (tmp_path / "config.yaml").write_text(
        "model: {class_path: fluidsnet.FluidsNet, init_args: {target: AccelerationTarget}}"
    )
    with pytest.raises(UserError, match="made with the target VelocityTarget"):
        fluidsnet.load(tmp_path)


def test_a_state_that_a_model_cannot_step_is_refused(sample: Path) -> None:
    assert read_state(sample / "test.h5", 0.04).scene.time_step == pytest.approx(0.04)
    with pytest.raises(UserError, match=r"0.03 s is no multiple of the frame interval, 0.02 s"):
        read_state(sample / "test.h5", 0.03)
    with pytest.raises(UserError, match="no frame 0 of /7"):
        read_state(sample / "test.h5", 0.02, simulation="7")
    with pytest.raises(UserError, match="no frame 1000 of"):
        read_state(sample / "test.h5", 0.02, frame=1000)
