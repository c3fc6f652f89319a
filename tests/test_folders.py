"""Folders that are written to: by one process at a time, on a full or read-only disk."""

from __future__ import annotations

import multiprocessing
import os
import resource
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.synchronize import Event
from pathlib import Path

import h5py
import pytest

from datamodules.generate.command import generate_command
from fluidsnet.errors import UserError
from fluidsnet.folder_lock import FolderLock
from fluidsnet.main import main
from fluidsnet.whole_file import whole_file, write_whole

ROOT = Path(__file__).parents[1]
CONFIGS = [
    f"--config={ROOT / 'configs' / name}"
    for name in ("trainer.yaml", "model/paper.yaml", "data/sample.yaml")
]


@contextmanager
def full_disk(size: int) -> Iterator[None]:
    """Let no file grow beyond some bytes, as on a disk that is full."""
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, ignored)


def test_a_file_on_a_full_disk_is_the_earlier_one(tmp_path: Path) -> None:
    path = tmp_path / "table.md"
    write_whole(path, "earlier")
    words = "table.md cannot be written: File too large; the earlier one is whole"
    with full_disk(1000), pytest.raises(UserError, match=words):
        write_whole(path, "x" * 10_000)
    assert path.read_text() == "earlier"
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_that_is_interrupted_is_the_earlier_one(tmp_path: Path) -> None:
    path = tmp_path / "table.md"
    write_whole(path, "earlier")
    with pytest.raises(KeyboardInterrupt), whole_file(path) as partial:
        partial.write_text("half")
        raise KeyboardInterrupt
    assert path.read_text() == "earlier"
    assert list(tmp_path.iterdir()) == [path]


def hold(folder: Path, held: Event) -> None:
    with FolderLock(folder):
        held.set()
        signal.pause()


@pytest.fixture
def holding() -> Iterator[Callable[[Path], multiprocessing.Process]]:
    """Starts a process that holds a folder."""
    processes = []

    def start(folder: Path) -> multiprocessing.Process:
        context = multiprocessing.get_context("spawn")
        held = context.Event()
        process = context.Process(target=hold, args=(folder, held), daemon=True)
        process.start()
        processes.append(process)
        assert held.wait(120)
        return process

    yield start
    for process in processes:
        process.kill()
        process.join()


def test_a_folder_has_one_process_at_a_time(
    tmp_path: Path, holding: Callable[[Path], multiprocessing.Process]
) -> None:
    other = holding(tmp_path / "run")
    with pytest.raises(UserError, match="run is in use by another process"):
        FolderLock(tmp_path / "run").__enter__()
    other.kill()
    other.join()
    with FolderLock(tmp_path / "run"):
        assert list((tmp_path / "run").iterdir()) == []


def commands(folder: Path, sample: Path) -> dict[str, list[str]]:
    logger = {"save_dir": folder.parent, "name": folder.name, "version": ""}
    named = [f"--trainer.logger.init_args.{name}={value}" for name, value in logger.items()]
    few = ["--trainer.max_steps=1", "--trainer.enable_progress_bar=false"]
    data = [f"--data.init_args.root={sample}"]
    scene = f"--config={ROOT / 'configs/scene/sample.yaml'}"
    counts = {"train": 1, "val": 0, "test": 0, "frames": 2}
    recipe = [f"--recipe.{name}={value}" for name, value in counts.items()]
    models = "--models=[{model: dam_break_small}]"
    return {
        "fit": ["fit", *CONFIGS, *named, *data, *few],
        "generate": ["generate", scene, f"--root={folder}", *recipe],
        "trade": ["trade", f"--data={sample / 'test.h5'}", models, f"--output={folder}"],
        "stress": ["stress", "--run=dam_break_small", "--steps=2", f"--output={folder}"],
    }


def test_a_forked_process_does_not_keep_a_folder(tmp_path: Path) -> None:
    context = multiprocessing.get_context("fork")
    begun, done = context.Event(), context.Event()

    def work() -> None:
        begun.set()
        done.wait()

    with FolderLock(tmp_path):
        worker = context.Process(target=work)
        worker.start()
        assert begun.wait(60)
    with FolderLock(tmp_path):
        done.set()
    worker.join()


@pytest.mark.usefixtures("real_solver")
def test_commands_refuse_a_folder_that_another_process_writes_to(
    tmp_path: Path,
    sample: Path,
    holding: Callable[[Path], multiprocessing.Process],
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = tmp_path / "output"
    holding(folder)
    for name, arguments in commands(folder, sample).items():
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        assert ended.value.code == 1, name
        assert f"{folder} is in use by another process" in capsys.readouterr().err, name
        # A logger has a file of its own in it.
        left = [it for it in folder.iterdir() if not it.name.startswith("events.out")]
        assert left == [], name


def test_a_folder_that_cannot_be_made_is_named(
    tmp_path: Path, sample: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    folder = tmp_path / "file" / "output"
    for name in ("fit", "trade", "stress"):
        with pytest.raises(SystemExit) as ended:
            main(commands(folder, sample)[name])
        said = capsys.readouterr().err
        assert ended.value.code == 1, name
        assert "Not a directory" in said and "Traceback" not in said, said


@pytest.mark.usefixtures("real_solver")
def test_generate_on_a_full_disk_keeps_what_is_complete(tmp_path: Path) -> None:
    root = tmp_path / "data"
    arguments = [f"--config={ROOT / 'configs/scene/sample.yaml'}", f"--root={root}"]
    counts = {"train": 1, "val": 0, "test": 0, "frames": 20}
    arguments += [f"--recipe.{name}={value}" for name, value in counts.items()]
    with full_disk(30_000), pytest.raises(UserError, match="no space left on the disk; make room"):
        generate_command(arguments)
    assert not list(root.glob("*.h5"))
    generate_command(arguments)
    with h5py.File(root / "train.h5") as file:
        assert len(file["00000/position"]) == 20
    assert os.listdir(root) != []
