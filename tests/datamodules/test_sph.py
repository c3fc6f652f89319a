"""Tests of the data module: samples, frames, statistics, identity."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import torch
from torch import Tensor

from datamodules import SPHDataModule
from datamodules.augmentation import BoxSymmetry
from datamodules.reader import FrameReader
from datamodules.transitions import STATISTICS_SAMPLES, Sample, TransitionDataset
from fluidsnet.errors import UserError
from fluidsnet.particles import Transitions

Write = Callable[..., Path]

FIELDS = ("velocity_mean", "velocity_deviation", "change_mean", "change_deviation")
FIELDS += ("drift_deviation",)


@pytest.fixture
def small(write_file: Write) -> Path:
    """Write three files with simulations of different lengths and numbers of particles."""
    write_file("val.h5", (9, 4, 2), seed=1)
    write_file("test.h5", (11, 3, 2), (6, 5, 4), seed=2)
    return write_file("train.h5", (12, 5, 3), (10, 7, 4), seed=0).parent


def module(root: Path, stage: str = "fit", **options: Any) -> SPHDataModule:
    data = SPHDataModule(root, **{"voxel_size": 0.25, **options})
    data.setup(stage)
    return data


def starts(data: SPHDataModule, split: str = "train") -> list[tuple[str, int]]:
    return [(sample.simulation, sample.frame) for sample in data._samples_of(split)]


@pytest.mark.parametrize(
    ("options", "first", "second"),
    [
        # Of 12 and of 10 frames: the last start is frames - 1 - steps * stride.
        ({}, list(range(11)), list(range(9))),
        ({"stride": 3}, list(range(9)), list(range(7))),
        ({"steps": 2}, list(range(10)), list(range(8))),
        ({"stride": 3, "steps": 3}, [0, 1, 2], [0]),
        ({"sample_every": 4}, [0, 4, 8], [0, 4, 8]),
        ({"frame_range": (4, None)}, list(range(4, 11)), list(range(4, 9))),
        ({"frame_range": (4, 8)}, [4, 5, 6], [4, 5, 6]),
        ({"frame_range": (4, 11), "stride": 2}, [4, 5, 6, 7, 8], [4, 5, 6, 7]),
        ({"frame_range": (1, 11), "steps": 2, "sample_every": 3}, [1, 4, 7], [1, 4, 7]),
        ({"frame_range": (9, 12)}, [9, 10], []),
    ],
)
def test_samples_by_hand(
    small: Path, options: dict[str, Any], first: list[int], second: list[int]
) -> None:
    data = SPHDataModule(small, voxel_size=0.25, **options)
    expected = [("00000", frame) for frame in first] + [("00001", frame) for frame in second]
    assert starts(data) == expected
    assert len(data.train_dataloader().dataset) == len(expected)  # type: ignore[arg-type]


@pytest.mark.parametrize(("stride", "steps"), [(1, 1), (2, 1), (1, 3), (3, 2)])
def test_the_next_states_are_the_files_own(sample: Path, stride: int, steps: int) -> None:
    data = module(sample, stride=stride, steps=steps)
    dataset = data.train_dataloader().dataset
    with h5py.File(sample / "train.h5") as file:
        for index in (0, 17, len(dataset) - 1):  # type: ignore[arg-type]
            name, frame = starts(data)[index]
            group = file[name]
            transitions = dataset[index]
            np.testing.assert_array_equal(transitions.state.position, group["position"][frame])
            np.testing.assert_array_equal(transitions.state.velocity, group["velocity"][frame])
            later = slice(frame + stride, frame + steps * stride + 1, stride)
            assert len(transitions.next_position) == steps
            np.testing.assert_array_equal(transitions.next_position, group["position"][later])
            np.testing.assert_array_equal(transitions.next_velocity, group["velocity"][later])
            assert transitions.state.scene.time_step == pytest.approx(0.02 * stride)


def test_each_frame_of_a_sample_is_read_once(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reads: Counter[tuple[str, int]] = Counter()
    fluid = FrameReader.fluid

    def counted(self: FrameReader, simulation: str, frame: int) -> tuple[Tensor, Tensor]:
        reads[simulation, frame] += 1
        return fluid(self, simulation, frame)

    data = module(small, stride=2, steps=3)
    dataset = data.train_dataloader().dataset
    monkeypatch.setattr(FrameReader, "fluid", counted)
    dataset[1]
    assert reads == {("00000", frame): 1 for frame in (1, 3, 5, 7)}


def test_validation_takes_one_step_whatever_training_takes(small: Path) -> None:
    data = module(small, steps=3)
    assert len(next(iter(data.train_dataloader())).next_position) == 3
    assert len(next(iter(data.val_dataloader())).next_position) == 1


def where(samples: list[Sample]) -> set[tuple[Path, str, int]]:
    return {(sample.reader.path, sample.simulation, sample.frame) for sample in samples}


def test_splits_by_simulation_share_nothing(sample: Path) -> None:
    data = SPHDataModule(sample, voxel_size=0.25)
    sources = []
    for split in ("train", "val", "test"):
        samples = data._samples_of(split)
        assert samples
        sources.append({(path, simulation) for path, simulation, _ in where(samples)})
    assert not (sources[0] & sources[1] or sources[0] & sources[2] or sources[1] & sources[2])


def test_the_split_by_frame_deals_four_fifths_and_tests_on_the_validation(sample: Path) -> None:
    by_simulation = SPHDataModule(sample, voxel_size=0.25)
    everything = where(by_simulation._samples_of("train") + by_simulation._samples_of("val"))
    data = SPHDataModule(sample, voxel_size=0.25, split_by="frame")
    train, val, test = (data._samples_of(split) for split in ("train", "val", "test"))
    assert where(train) | where(val) == everything
    assert not where(train) & where(val)
    assert len(train) == round(0.8 * len(everything)) == len(where(train))
    assert where(test) == where(val)
    # Both files are on both sides: this is the leak that the option is documented to have.
    assert {path.name for path, _, _ in where(val)} == {"train.h5", "val.h5"}

    again = SPHDataModule(sample, voxel_size=0.25, split_by="frame")
    assert where(again._samples_of("train")) == where(train)
    other = SPHDataModule(sample, voxel_size=0.25, split_by="frame", seed=1)
    assert where(other._samples_of("train")) != where(train)


def test_statistics_are_those_of_plain_numpy_over_the_training_file(sample: Path) -> None:
    stride = 2
    data = module(sample, stride=stride)
    assert len(data._samples_of("train")) <= STATISTICS_SAMPLES, "then each sample counts"
    rows: dict[str, list[Any]] = {"velocity": [], "change": [], "drift": []}
    with h5py.File(sample / "train.h5") as file:
        for group in file.values():
            position, velocity = (
                group[name][()].astype(np.float64) for name in ("position", "velocity")
            )
            before, after = velocity[:-stride], velocity[stride:]
            rows["velocity"].append(before.reshape(-1, 3))
            rows["change"].append((after - before).reshape(-1, 3))
            moved = position[stride:] - position[:-stride]
            drift = (moved - 0.02 * stride * before) / file.attrs["support_radius"]
            rows["drift"].append(drift.reshape(-1, 3))
    for name, parts in rows.items():
        values = np.concatenate(parts)
        deviation = getattr(data.statistics, f"{name}_deviation")
        if name != "drift":
            mean = getattr(data.statistics, f"{name}_mean")
            np.testing.assert_allclose(mean, values.mean(axis=0), rtol=1e-4, atol=1e-6)
        assert float(deviation) == pytest.approx(np.sqrt(values.var(axis=0).mean()), rel=1e-4)


def test_statistics_know_nothing_of_validation_and_test(small: Path, write_file: Write) -> None:
    before = module(small).statistics
    write_file("val.h5", (20, 9, 2), seed=7)
    write_file("test.h5", (20, 9, 2), seed=8)
    after = module(small).statistics
    write_file("train.h5", (12, 5, 3), (10, 7, 4), seed=9)
    other = module(small).statistics
    for field in FIELDS:
        assert torch.equal(getattr(before, field), getattr(after, field))
        assert not torch.equal(getattr(before, field), getattr(other, field))


def test_statistics_read_a_bounded_number_of_samples(
    write_file: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = write_file("train.h5", (2 * STATISTICS_SAMPLES, 2, 1)).parent
    read = []
    item = TransitionDataset.__getitem__

    def counted(self: TransitionDataset, index: int) -> Transitions:
        read.append(index)
        return item(self, index)

    monkeypatch.setattr(TransitionDataset, "__getitem__", counted)
    assert SPHDataModule(root, voxel_size=0.25).statistics
    assert STATISTICS_SAMPLES / 2 < len(read) <= STATISTICS_SAMPLES
    assert max(read) > 2 * STATISTICS_SAMPLES - 4, "spread over the whole split"


def test_statistics_of_a_fluid_at_rest_are_never_zero(write_file: Write) -> None:
    path = write_file("train.h5", (4, 5, 2))
    with h5py.File(path, "a") as file:
        file["00000/velocity"][...] = 0
        file["00000/position"][...] = 0.5
    statistics = SPHDataModule(path.parent, voxel_size=0.25).statistics
    for field in FIELDS:
        if field.endswith("deviation"):
            assert 0 < float(getattr(statistics, field)) < 1e-6


def test_frames_of_different_numbers_of_particles_make_a_batch(small: Path) -> None:
    data = module(small, stage="test", batch_size=100)
    (batch,) = list(data.test_dataloader())
    state = batch.state
    # 10 transitions of 3 particles and 2 solids, then 5 of 5 and 4.
    assert state.frames == 15
    assert torch.bincount(state.frame).tolist() == [3] * 10 + [5] * 5
    assert torch.bincount(state.solid_frame).tolist() == [2] * 10 + [4] * 5
    assert bool((state.frame.diff() >= 0).all()) and bool((state.solid_frame.diff() >= 0).all())
    assert state.frame.dtype == torch.int64
    assert state.position.shape == state.velocity.shape == (55, 3) == batch.next_position.shape[1:]
    assert len(state) == 55
    with h5py.File(small / "test.h5") as file:
        for index, (name, frame) in enumerate(starts(data, "test")):
            rows = state.frame == index
            np.testing.assert_array_equal(state.position[rows], file[name]["position"][frame])
            np.testing.assert_array_equal(
                batch.next_velocity[0, rows], file[name]["velocity"][frame + 1]
            )
            np.testing.assert_array_equal(
                state.solid_position[state.solid_frame == index], file[name]["solid_position"]
            )


@pytest.mark.parametrize(
    ("upper", "voxel_size", "cells"),
    [
        ((1.5, 1.0, 1.5), 1 / 12, (18, 12, 18)),
        ((7.0, 7.0, 7.0), 1 / 3, (21, 21, 21)),
        ((6.0, 4.0, 6.0), 1 / 3, (18, 12, 18)),
        ((1.5, 1.0, 1.5), 0.1, (15, 10, 15)),
        ((1.5, 1.0, 1.5), 0.4, (4, 3, 4)),
        ((1.5, 1.0, 1.5), 5.0, (1, 1, 1)),
    ],
)
def test_cells_cover_the_domain(
    write_file: Write, upper: tuple[float, ...], voxel_size: float, cells: tuple[int, ...]
) -> None:
    root = write_file("train.h5", (2, 2, 2), domain_upper=upper).parent
    assert SPHDataModule(root, voxel_size=voxel_size).grid_shape == cells


def test_the_scene_is_known_before_setup(sample: Path) -> None:
    data = SPHDataModule(sample, voxel_size=1 / 12, stride=2)
    assert data.time_step == pytest.approx(0.04)
    assert data.grid_shape == (18, 12, 18)


def test_the_identity_of_a_split_is_plain_json_and_follows_the_file(
    small: Path, write_file: Write
) -> None:
    data = SPHDataModule(small, voxel_size=0.25, stride=2, frame_range=(1, None), sample_every=3)
    identity = data.identity("test")
    content = (small / "test.h5").read_bytes()
    assert json.loads(json.dumps(identity)) == identity
    assert identity == {
        "root": str(small),
        "file": "test.h5",
        "sha256": hashlib.sha256(content).hexdigest(),
        "stride": 2,
        "time_step": pytest.approx(0.04),
        "frame_range": [1, None],
        "sample_every": 3,
        "simulations": 2,
        "frames": 17,
    }
    assert data.identity("val")["file"] == "val.h5"
    write_file("test.h5", (11, 3, 2), (6, 5, 4), seed=3)
    assert data.identity("test") == identity, "the hash is computed once"
    other = SPHDataModule(small, voxel_size=0.25).identity("test")
    assert other["sha256"] != identity["sha256"]
    (small / "test.h5").unlink()
    with pytest.raises(UserError, match=r"test\.h5: there is no such file"):
        SPHDataModule(small, voxel_size=0.25).identity("test")


def test_the_identity_of_a_split_by_frame_names_all_files(small: Path) -> None:
    data = SPHDataModule(small, voxel_size=0.25, split_by="frame", seed=4)
    assert data.identity("test")["file"] == "train.h5, val.h5, test.h5"
    assert data.identity("test")["frames"] == 12 + 10 + 9 + 11 + 6
    assert (data.identity("test")["split_by"], data.identity("test")["seed"]) == ("frame", 4)
    (small / "test.h5").unlink()
    without = SPHDataModule(small, voxel_size=0.25, split_by="frame", seed=4).identity("test")
    assert without["file"] == "train.h5, val.h5"
    contents = [(small / name).read_bytes() for name in ("train.h5", "val.h5")]
    hashes = [hashlib.sha256(content).hexdigest() for content in contents]
    assert without["sha256"] == ", ".join(hashes)


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("voxel_size", 0.0),
        ("voxel_size", float("nan")),
        ("stride", 0),
        ("steps", 0),
        ("sample_every", -1),
        ("batch_size", 0),
        ("rollout_steps", 0),
        ("workers", -1),
        ("frame_range", (-3, None)),
        ("frame_range", (5, 5)),
        ("frame_range", (5, 4)),
    ],
)
def test_a_bad_number_is_named(sample: Path, option: str, value: Any) -> None:
    with pytest.raises(UserError, match=rf"data\.{option} is .*\.$"):
        SPHDataModule(sample, **{"voxel_size": 0.25, option: value})


def test_a_wrong_root_is_named(tmp_path: Path) -> None:
    data = SPHDataModule(tmp_path / "nowhere", voxel_size=0.25)
    with pytest.raises(UserError, match=r"nowhere holds none of .*fluidsnet generate"):
        _ = data.scene
    with pytest.raises(UserError, match=r"nowhere/train\.h5: there is no such file"):
        data.setup("fit")


@pytest.mark.parametrize("options", [{"frame_range": (30, None)}, {"stride": 8, "steps": 2}])
def test_a_range_without_a_sample_is_named(small: Path, options: dict[str, Any]) -> None:
    with pytest.raises(UserError, match=r"no sample for train: .*frame_range .*\.$"):
        module(small, **options)


def test_one_batch_mixes_boxes_gravities_and_viscosities(write_file: Write) -> None:
    boxes, pulls = [(2.0, 2.0, 2.0), (3.5, 2.0, 2.0)], [(0.0, -9.81, 0.0), (0.0, -1.6, 0.0)]
    root = write_file(
        "train.h5", (3, 5, 3), (3, 7, 4), domain_upper=boxes, gravity=pulls, viscosity=[0.01, 0.5]
    ).parent
    write_file("val.h5", (3, 4, 2), domain_upper=(9.0, 2.0, 2.0))
    data = module(root, batch_size=4)
    assert data.scenes.names == ("train/00000", "train/00001", "val/00000")
    state = next(iter(data.train_dataloader())).state
    assert state.frames == len(state.scene) == 4
    for frame, name in enumerate(state.scene.names):
        number = int(name.removeprefix("train/"))
        assert state.scene.edges[frame] == boxes[number]
        assert state.scene.extent[frame].tolist() == list(boxes[number])
        assert state.scene.gravity[frame].tolist() == pytest.approx(pulls[number])
        assert float(state.scene.viscosity[frame]) == pytest.approx((0.01, 0.5)[number])
        assert int((state.frame == frame).sum()) == (5, 7)[number]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("particle_radius", 0.025),
        ("support_radius", 0.1),
        ("dt", 0.01),
    ],
)
def test_splits_of_different_resolutions_are_refused(
    small: Path, write_file: Write, name: str, value: Any
) -> None:
    write_file("val.h5", (9, 4, 2), **{name: value})
    with pytest.raises(
        UserError, match=rf"val\.h5: {name} is .*one resolution and frame interval\.$"
    ):
        module(small)


def test_a_damaged_split_is_named(small: Path) -> None:
    content = (small / "val.h5").read_bytes()
    (small / "val.h5").write_bytes(content[:-100])
    with pytest.raises(UserError, match=r"val\.h5: not a whole HDF5 file"):
        module(small)


def batches(data: SPHDataModule) -> list[Transitions]:
    torch.manual_seed(3)
    return [*data.train_dataloader(), *data.val_dataloader()]


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_workers_change_nothing(small: Path) -> None:
    alone = batches(module(small, batch_size=4, steps=2))
    data = module(small, batch_size=4, steps=2, workers=2)
    _ = data.statistics  # leaves the file open, as fit does
    together = batches(data)
    assert len(alone) == len(together) > 4
    for one, other in zip(alone, together, strict=True):
        assert torch.equal(one.state.position, other.state.position)
        assert torch.equal(one.state.frame, other.state.frame)
        assert torch.equal(one.state.solid_position, other.state.solid_position)
        assert torch.equal(one.next_position, other.next_position)
        assert torch.equal(one.next_velocity, other.next_velocity)


def test_training_is_shuffled_and_validation_is_not(small: Path) -> None:
    data = module(small, batch_size=1)
    torch.manual_seed(0)
    dataset = data.train_dataloader().dataset
    ordered = [dataset[index].state.position[0] for index in range(len(dataset))]  # type: ignore[arg-type]
    drawn = [batch.state.position[0] for batch in data.train_dataloader()]
    assert not torch.equal(torch.stack(drawn), torch.stack(ordered))
    assert {tuple(row.tolist()) for row in drawn} == {tuple(row.tolist()) for row in ordered}
    with h5py.File(small / "val.h5") as file:
        first = [batch.state.position.numpy() for batch in data.val_dataloader()]
        np.testing.assert_array_equal(np.stack(first), file["00000/position"][:-1])


@pytest.mark.parametrize(
    ("stride", "states"), [(1, (11, 6)), (2, (6, 3)), (5, (3, 2)), (4, (3, 2))]
)
def test_rollouts_start_at_the_first_frame_and_go_to_the_last(
    small: Path, stride: int, states: tuple[int, int]
) -> None:
    data = module(small, stage="predict", stride=stride)
    rollouts = list(data.predict_dataloader())
    assert [start.name for start in rollouts] == ["00000", "00001"]
    with h5py.File(small / "test.h5") as file:
        for start, length in zip(rollouts, states, strict=True):
            assert len(start.truth) == length
            assert start.steps == length - 1
            position, velocity = start.truth[0]
            assert torch.equal(position, start.state.position)
            assert torch.equal(velocity, start.state.velocity)
            last = (length - 1) * stride
            np.testing.assert_array_equal(
                start.truth[length - 1][0], file[start.name]["position"][last]
            )
            assert start.state.frames == 1


def test_rollout_steps_may_go_beyond_the_truth(small: Path) -> None:
    data = module(small, stage="predict", rollout_steps=40)
    for start in data.predict_dataloader():
        assert start.steps == 40 > len(start.truth)
        assert start.known_steps == len(start.truth) - 1


def test_a_file_of_one_frame_can_be_rolled_out(write_file: Write) -> None:
    root = write_file("test.h5", (1, 3, 2)).parent
    (start,) = module(root, stage="predict", rollout_steps=5).predict_dataloader()
    assert (start.steps, start.first, start.known_steps, len(start.truth)) == (5, 0, 0, 1)
    assert torch.equal(start.truth[0][0], start.state.position)
    with pytest.raises(UserError, match=r"has 1 frame\(s\).*; set data\.rollout_steps to .*\.$"):
        module(root, stage="predict").predict_dataloader()


def test_each_stage_needs_its_own_file_only(small: Path) -> None:
    (small / "val.h5").unlink()
    (small / "train.h5").unlink()
    module(small, stage="test")
    module(small, stage="predict")
    with pytest.raises(UserError, match=r"train\.h5"):
        module(small, stage="fit")


def test_the_split_by_frame_tests_without_a_test_file(small: Path, write_file: Write) -> None:
    (small / "test.h5").unlink()
    for stage in ("fit", "validate", "test"):
        data = module(small, stage=stage, split_by="frame")
    assert sum(batch.state.frames for batch in data.test_dataloader()) == len(starts(data, "test"))
    data.teardown("test")
    write_file("train.h5", (12, 5, 3), dt=0.01)
    for stage in ("fit", "validate", "test"):
        with pytest.raises(UserError, match="one resolution"):
            module(small, stage=stage, split_by="frame")
    (small / "train.h5").unlink()
    with pytest.raises(UserError, match=r"train\.h5: there is no such file"):
        module(small, stage="test", split_by="frame")


@pytest.mark.parametrize("gravity", [(0.0, 0.0, 0.0), (1.0, -9.81, 0.0)])
def test_an_augmentation_that_does_not_fit_is_refused_before_training(
    write_file: Write, gravity: tuple[float, float, float]
) -> None:
    root = write_file("train.h5", (4, 5, 2), gravity=gravity).parent
    for split in ("val", "test"):
        write_file(f"{split}.h5", (4, 5, 2), gravity=gravity)
    with pytest.raises(UserError, match=r"BoxSymmetry needs gravity along one axis.*leave out"):
        module(root, augmentation=BoxSymmetry())
    # What is not trained is not augmented.
    module(root, stage="test", augmentation=BoxSymmetry())
    module(root)


def test_a_batch_goes_to_its_device(sample: Path, device: torch.device) -> None:
    data = module(sample, batch_size=2)
    batch = data.transfer_batch_to_device(next(iter(data.val_dataloader())), device, 0)
    assert batch.state.position.device.type == batch.next_position.device.type == device.type
    assert batch.state.scene.gravity.device.type == device.type


def test_teardown_closes_the_files(sample: Path, tmp_path: Path) -> None:
    root = tmp_path / "copy"
    shutil.copytree(sample, root)
    data = module(root)
    next(iter(data.train_dataloader()))
    data.teardown("fit")
    assert all(reader._handle is None for reader in data._readers.values())
