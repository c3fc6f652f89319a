"""Tests of `fluidsnet convert` on records of DeepLagrangianFluids."""

from __future__ import annotations

import csv
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import msgpack
import msgpack_numpy
import numpy as np
import pytest
import zstandard

from datamodules.convert.command import convert_command
from datamodules.inspection import summarize
from datamodules.schema import Header, SceneAttributes, simulations
from fluidsnet.errors import UserError
from fluidsnet.main import main

CONFIGS = Path(__file__).parents[2] / "configs"

Record = dict[str, Any]
Spoil = Callable[[list[Record]], None]


def records_of(group: h5py.Group, radius: float) -> list[Record]:
    """Return the frames of a simulation as ``create_physics_records.py`` makes them."""
    fluid, walls = group["position"].shape[1], group["solid_position"][()]
    records = []
    for frame in range(len(group["position"])):
        records.append(
            {
                "frame_id": np.int64(frame),
                "scene_id": "sim",
                "pos": group["position"][frame],
                "vel": group["velocity"][frame],
                "m": np.full(fluid, 1000 * (2 * radius) ** 3, np.float32),
                "viscosity": np.full(fluid, 0.01, np.float32),
                "box": walls,
                "box_normals": np.eye(3, dtype=np.float32)[np.arange(len(walls)) % 3],
            }
        )
    return records


def write_records(path: Path, records: list[Record]) -> None:
    """Write a file with the packages that DeepLagrangianFluids writes it with."""
    for record in records[1:]:
        record.pop("box", None), record.pop("box_normals", None)
    packed = msgpack.packb(records, use_bin_type=True, default=msgpack_numpy.encode)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(zstandard.ZstdCompressor(level=3).compress(packed))


@pytest.fixture
def records(sample: Path, tmp_path: Path) -> Path:
    """The sample as records: three files for each simulation."""
    root = tmp_path / "records"
    for split, folder in (("train", "train"), ("val", "valid"), ("test", "valid")):
        with h5py.File(sample / f"{split}.h5") as file:
            for name, group in file.items():
                frames = records_of(group, file.attrs["particle_radius"])
                for part, rows in enumerate(np.array_split(np.arange(len(frames)), 3)):
                    write_records(
                        root / folder / f"sim_{split}{name[-2:]}_{part:02d}.msgpack.zst",
                        [frames[row] for row in rows],
                    )
    return root


SPLIT = ("train=train/*", "val=valid/sim_val*", "test=valid/sim_test*")


def convert(*arguments: object) -> None:
    convert_command([str(argument) for argument in arguments])


def test_records_become_the_simulation_they_were(
    records: Path, sample: Path, tmp_path: Path
) -> None:
    convert(records, "--root", tmp_path / "out", "--particle-radius", 0.06, "--split", *SPLIT)
    for split in ("train", "val", "test"):
        with (
            h5py.File(sample / f"{split}.h5") as before,
            h5py.File(tmp_path / "out" / f"{split}.h5") as after,
        ):
            assert simulations(after) == simulations(before)
            for name in simulations(after):
                for data in ("position", "velocity", "solid_position"):
                    assert np.array_equal(after[name][data][()], before[name][data][()])
                assert np.allclose(after[name]["time"], before[name]["time"])
                assert after[name]["solid_normal"].shape == after[name]["solid_position"].shape
                scene = SceneAttributes.read(after[name])
                assert scene.viscosity == 0.01 and scene.density0 == pytest.approx(1000, rel=1e-5)
                assert scene.gravity == (0, -9.81, 0)
                assert scene.domain_upper == pytest.approx((1.5, 1, 1.5))
            header = Header.read(after)
            assert (header.dt, header.support_radius) == (0.02, 0.24)
    assert "nothing suspicious" in summarize(tmp_path / "out" / "train.h5").text


def test_folders_are_splits_and_constants_are_known(records: Path, tmp_path: Path) -> None:
    convert(records, "--root", tmp_path / "out", "--density0", 1000)
    with h5py.File(tmp_path / "out" / "val.h5") as file:
        assert [group.attrs["source"] for group in file.values()] == [
            "valid/sim_test00",
            "valid/sim_val00",
        ]
        assert Header.read(file).particle_radius == 0.025
    assert not (tmp_path / "out" / "test.h5").exists()


def test_a_network_trains_on_it_and_rolls_out(sample: Path, tmp_path: Path) -> None:
    for split in ("train", "val", "test"):
        with h5py.File(sample / f"{split}.h5") as file:
            frames = records_of(file["00000"], 0.06)[:8]
        write_records(tmp_path / "in" / split / "sim_00.msgpack.zst", frames)
    data = tmp_path / "out"
    convert(tmp_path / "in", "--root", data, "--particle-radius", 0.06)
    configs = "trainer", "model/corrected", "data/sample"
    main(
        [
            *("fit", *(f"--config={CONFIGS / name}.yaml" for name in configs)),
            *(f"--data.init_args.root={data}", "--data.init_args.workers=0"),
            *("--trainer.max_epochs=-1", "--trainer.max_steps=10"),
            *("--trainer.limit_val_batches=1", "--trainer.enable_progress_bar=false"),
            f"--trainer.logger.init_args.save_dir={tmp_path}",
            *("--trainer.logger.init_args.name=run", "--trainer.logger.init_args.version="),
        ]
    )
    run = tmp_path / "run"
    main(["test", f"--run={run}"])
    with (run / "results" / "out" / "one_step.csv").open() as file:
        names = [row[0] for row in csv.reader(file)]
    assert "model" in names and "ballistic" in names
    main(["predict", f"--run={run}", "--data.init_args.rollout_steps=3"])
    assert len(list((run / "results" / "out" / "rollouts").glob("*.vtkhdf"))) == 1


def two_viscosities(records: list[Record]) -> None:
    records[0]["viscosity"][0] = 0.3


def another_density(records: list[Record]) -> None:
    records[0]["m"][:9] *= 2


def no_velocity(records: list[Record]) -> None:
    del records[1]["vel"]


def flat(records: list[Record]) -> None:
    records[1]["pos"] = records[1]["pos"].ravel()


def jump(records: list[Record]) -> None:
    records[2]["frame_id"] = np.int64(9)


def fewer(records: list[Record]) -> None:
    records[2]["pos"], records[2]["vel"] = records[2]["pos"][1:], records[2]["vel"][1:]


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (two_viscosities, "sim_a: its fluids differ in viscosity, 0.01 to 0.3.*--viscosity"),
        (another_density, "sim_a: its fluids differ in density0"),
        (no_velocity, "frame 1 has no vel"),
        (flat, "pos of frame 1 has shape"),
        (jump, "frame 9 follows frame 1"),
        (fewer, "the number of particles changes from 264 to 263 at frame 2"),
    ],
)
def test_faults_are_named(spoil: Spoil, words: str, sample: Path, tmp_path: Path) -> None:
    with h5py.File(sample / "train.h5") as file:
        frames = records_of(file["00002"], 0.025)[:4]
    spoil(frames)
    write_records(tmp_path / "in" / "sim_a_00.msgpack.zst", frames)
    with pytest.raises(UserError, match=words):
        convert(tmp_path / "in", "--root", tmp_path / "out", "--split", "train=*")
    assert not [*(tmp_path / "out").iterdir()]


def test_one_value_for_all_fluids(sample: Path, tmp_path: Path) -> None:
    with h5py.File(sample / "train.h5") as file:
        frames = records_of(file["00002"], 0.025)[:4]
    two_viscosities(frames)
    write_records(tmp_path / "in" / "sim_a_00.msgpack.zst", frames)
    convert(tmp_path / "in", "--root", tmp_path / "out", "--split", "test=*", "--viscosity", 0.2)
    with h5py.File(tmp_path / "out" / "test.h5") as file:
        assert SceneAttributes.read(file["00000"]).viscosity == 0.2


def test_a_missing_file_is_noticed(records: Path, tmp_path: Path) -> None:
    (records / "valid" / "sim_val00_01.msgpack.zst").unlink()
    with pytest.raises(UserError, match=r"frame 28 follows frame 13; a file .* is missing"):
        convert(records, "--root", tmp_path / "out")


class Bomb:
    def __reduce__(self) -> tuple[Any, ...]:
        return exec, ("raise SystemExit('it ran')",)


def test_objects_are_never_unpickled(tmp_path: Path) -> None:
    encoded = {b"nd": True, b"type": "O", b"kind": b"O", b"shape": (1,), b"data": b""}
    encoded[b"data"] = pickle.dumps(Bomb())
    packed = msgpack.packb([{"pos": encoded}], use_bin_type=True)
    with pytest.raises(SystemExit):  # msgpack_numpy runs it
        msgpack.unpackb(packed, object_hook=msgpack_numpy.decode)
    path = tmp_path / "in" / "sim_00.msgpack.zst"
    path.parent.mkdir()
    path.write_bytes(zstandard.ZstdCompressor().compress(packed))
    with pytest.raises(UserError, match="damaged or of another format: it holds Python objects"):
        convert(tmp_path / "in", "--root", tmp_path / "out", "--split", "train=*")


@pytest.mark.parametrize("size", [0, 10, 2000])
def test_truncated_records_are_refused(size: int, records: Path, tmp_path: Path) -> None:
    path = records / "train" / "sim_train00_00.msgpack.zst"
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(UserError, match=r"sim_train00_00\.msgpack\.zst: the file is damaged"):
        convert(records, "--root", tmp_path / "out")
