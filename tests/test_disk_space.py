"""Disks that fill while HDF5 files are written: one sentence, and nothing whole is lost."""

from __future__ import annotations

import os
import resource
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from datamodules.convert.command import convert_command
from datamodules.schema import SceneAttributes, open_valid
from datamodules.start_file import start_header, write_start
from fluidsnet.errors import UserError
from fluidsnet.export.vtkhdf import TrajectoryFile, read_field_data, read_frame
from tools.soak_runs import small_disk

CONFIGS = Path(__file__).parents[1] / "configs"

Disk = Callable[[int], Path]


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Disk]:
    """Mounts a file system of some kilobytes, which only root may do."""
    with ExitStack() as mounts:

        def mount(kilobytes: int) -> Path:
            if not mounts.enter_context(small_disk(tmp_path / "disk", kilobytes)):
                pytest.skip("only root may mount a small disk")
            return tmp_path / "disk"

        yield mount


def test_a_trajectory_keeps_the_steps_that_fit(disk: Disk) -> None:
    path = disk(1400) / "rollout.vtkhdf"
    position = np.random.default_rng(0).random((2000, 3), np.float32)
    kept = r"rollout.vtkhdf cannot be written: No space left on device; its (\d+) steps up to .* s"
    with pytest.raises(UserError, match=kept), TrajectoryFile(path, len(position)) as file:
        for step in range(1000):
            file.append(0.02 * step, position + step)
    assert [it.name for it in path.parent.iterdir()] == [path.name]
    times = read_field_data(path)["time"]
    assert len(times) > 5
    np.testing.assert_array_equal(read_frame(path, -1)[0], position + len(times) - 1)


@pytest.mark.parametrize("kilobytes", [500, 1200, 1600])
@pytest.mark.parametrize("to", [[], ["--to", "lagrangebench"]], ids=["from", "to"])
def test_a_data_set_that_does_not_fit_leaves_nothing(
    kilobytes: int, to: list[str], disk: Disk, sample: Path, tmp_path: Path
) -> None:
    source = sample
    if not to:
        source = tmp_path / "theirs"
        convert_command([str(sample), "--to", "lagrangebench", "--root", str(source)])
        to = ["--gravity", "0", "-9.81", "0"]
    root = disk(kilobytes) / "data"
    with pytest.raises(UserError, match=r"\.h5\.tmp cannot be written: No space left on device"):
        convert_command([str(source), *to, "--root", str(root)])
    assert list(root.iterdir()) == []


def test_room_is_checked_wherever_a_data_file_is_written(
    sample: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = shutil.disk_usage(tmp_path)
    header = start_header("Pool", particle_radius=0.05, frame_interval=0.02)
    with open_valid(sample / "val.h5") as file:
        scene = SceneAttributes.read(file["00000"])
    points = np.zeros((10, 3))
    arguments = (tmp_path / "start.h5", header, scene, (points, points), points)
    write_start(*arguments)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=1_049_000))
    with pytest.raises(UserError, match=r"start\.h5 cannot be written: No space left on device"):
        write_start(*arguments)
    file = TrajectoryFile(tmp_path / "rollout.vtkhdf", 2000)
    with pytest.raises(UserError, match=r"rollout\.vtkhdf cannot be written: No space left"):
        file.__enter__()


def no_large_files() -> None:
    """Let no file grow beyond 50 kB, which the size of the disk does not tell."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))


@pytest.mark.parametrize("command", ["predict", "convert"])
def test_hdf5_that_cannot_write_ends_the_program_in_words(
    command: str, sample: Path, tmp_path: Path
) -> None:
    arguments = {
        "predict": [
            f"--config={CONFIGS / 'model' / 'prior.yaml'}",
            *(f"--config={CONFIGS / name}" for name in ("trainer.yaml", "data/sample.yaml")),
            f"--data.init_args.root={sample}",
            "--trainer.callbacks=[callbacks.TrajectoryWriter]",
            f"--trainer.logger.init_args.save_dir={tmp_path}",
        ],
        "convert": [str(sample), "--to=lagrangebench", f"--root={tmp_path / 'data'}"],
    }
    # Not by `started`, whose processes end without HDF5's last writes.
    ended = subprocess.run(
        [sys.executable, "-m", "fluidsnet.main", command, *arguments[command]],
        preexec_fn=no_large_files, capture_output=True, text=True, check=False, timeout=120,
        env={**os.environ, "PYTHONPATH": str(CONFIGS.parent)},
    )  # fmt: skip
    assert ended.returncode == 1, ended
    said = ended.stderr.rstrip().splitlines()[-1]
    assert said.startswith("fluidsnet: ") and said.endswith("cannot be written: File too large.")
    assert "Traceback" not in ended.stderr and "excepthook" not in ended.stderr
