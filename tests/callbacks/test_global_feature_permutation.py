from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from lightning import Trainer

from callbacks import GlobalFeaturePermutation
from callbacks.global_feature_permutation import _derangement
from datamodules import SPHDataModule
from fluidsnet import FluidsNet
from fluidsnet.features import NoGlobalFeature
from fluidsnet.priors import FreeFall


def measure(model: FluidsNet, source: SPHDataModule, folder: Path) -> dict[str, float]:
    model.model.set_statistics(source.statistics, source.time_step)
    trainer = Trainer(
        default_root_dir=folder,
        devices=1,
        logger=False,
        enable_progress_bar=False,
        callbacks=[GlobalFeaturePermutation()],
    )
    found: dict[str, float] = trainer.test(model, source, verbose=False)[0]  # type: ignore[assignment]
    return found


@pytest.fixture
def source(sample: Path) -> Iterator[SPHDataModule]:
    # Four frames in batches of three: the last batch is shorter.
    made = SPHDataModule(sample, 0.25, sample_every=11, batch_size=3)
    yield made
    made.teardown("test")


@pytest.mark.parametrize("used", [False, True])
def test_the_ratio_says_whether_the_vector_is_used(
    source: SPHDataModule, tmp_path: Path, used: bool
) -> None:
    torch.manual_seed(0)
    model = FluidsNet(source.grid_shape)
    if not used:
        with torch.no_grad():
            model.model.network.head[0].weight[:, -model.model.network.global_feature.width :] = 0
    found = measure(model, source, tmp_path)
    own, ratio = (
        found["global_feature_permutation/velocity_mse/own"],
        found["global_feature_permutation/ratio"],
    )
    assert own == pytest.approx(found["test/model/velocity_mse"], rel=1e-5)
    assert found["global_feature_permutation/skill/own"] == pytest.approx(
        found["test/model/skill"], rel=1e-4
    )
    assert (ratio == pytest.approx(1.0, abs=1e-6)) == (not used)
    with (tmp_path / "results/dam_break" / "global_feature_permutation.csv").open() as file:
        rows = list(csv.reader(file))
    assert [row[0] for row in rows[1:]] == ["the frame itself", "another frame"]
    assert float(rows[2][3]) == pytest.approx(ratio)


@pytest.mark.parametrize("frames", [2, 3, 100])
def test_each_frame_gets_anothers_and_gives_its_own_once(frames: int) -> None:
    others = _derangement(frames)
    assert sorted(others) == list(range(frames))
    assert all(row != other for row, other in enumerate(others))
    assert others == _derangement(frames)


def test_the_foreign_vector_is_that_of_the_other_frame(
    source: SPHDataModule, tmp_path: Path
) -> None:
    torch.manual_seed(0)
    model = FluidsNet(source.grid_shape)
    found = measure(model, source, tmp_path)
    dataset = source.test_dataloader().dataset
    model.eval()
    errors = []
    with torch.no_grad():
        for row in range(4):
            own, other = dataset[row], dataset[_derangement(4)[row]]
            network = model.model.network
            vector = network.global_feature(
                other.state, network.features(other.state, FreeFall()(other.state))
            )[:1]
            state = model.model.step(own.state, vector.expand(len(own.state), -1))
            errors.append((state.velocity - own.next_velocity[0]).double().square().mean())
    expected = float(torch.stack(errors).mean())
    assert found["global_feature_permutation/velocity_mse/foreign"] == pytest.approx(
        expected, rel=1e-4
    )


def test_where_there_is_no_vector_it_says_so(
    source: SPHDataModule, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level("INFO"):
        found = measure(
            FluidsNet(source.grid_shape, global_feature=NoGlobalFeature), source, tmp_path
        )
    assert not [name for name in found if name.startswith("foreign")]
    assert "NoGlobalFeature is not one vector per frame" in caplog.text
    assert not (tmp_path / "results/dam_break" / "global_feature_permutation.csv").exists()
