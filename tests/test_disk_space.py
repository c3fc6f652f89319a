"""Disks that fill while HDF5 files are written: one sentence, and nothing whole is lost."""

from __future__ import annotations

import resource
import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from processes import started

from datamodules.convert.command import convert_command
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


def no_large_files() -> None:
    """Let no file grow beyond 50 kB, which the size of the disk does not tell."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))


def test_hdf5_that_cannot_write_ends_the_program_in_words(sample: Path, tmp_path: Path) -> None:
    output = tmp_path / "output.txt"
    arguments = [
        "predict",
        *(f"--config={CONFIGS / 'model' / 'prior.yaml'}", f"--config={CONFIGS / 'trainer.yaml'}"),
        *(f"--config={CONFIGS / 'data' / 'sample.yaml'}", f"--data.init_args.root={sample}"),
        "--trainer.callbacks=[callbacks.TrajectoryWriter]",
        f"--trainer.logger.init_args.save_dir={tmp_path}",
    ]
    process = started(arguments, output, first=no_large_files)
    process.join(120)
    said = output.read_text()
    assert process.exitcode == 1, said
    assert said.rstrip().endswith("00000.vtkhdf cannot be written: File too large."), said
    assert "Traceback" not in said and "excepthook" not in said
