"""`fluidsnet doctor` says what is installed, what runs, and what is missing."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest
import torch

from fluidsnet.doctor import missing
from fluidsnet.main import main

ROOT = Path(__file__).parents[1]


def doctor(**variables: str) -> dict[str, str]:
    """Lines of the command by their name, in a process with more environment variables."""
    done = subprocess.run(
        [sys.executable, "-m", "fluidsnet.main", "doctor"],
        env={**os.environ, "PYTHONPATH": str(ROOT), **variables},
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stderr) == (0, "")
    return {line[:13].strip(): line[13:] for line in done.stdout.splitlines()}


def test_versions_are_those_of_the_packages() -> None:
    lines = doctor()
    text = "\n".join(lines.values())
    assert "failed" not in text
    for package in ("torch", "lightning", "torch-cluster", "torch-scatter", "numba", "h5py"):
        assert f"{package} {metadata.version(package)}" in text
    assert lines["kernels"].startswith("on, for float32 on the CPU")
    assert lines["device"].startswith("CUDA" if torch.cuda.is_available() else "CPU")


def test_what_turns_kernels_off_and_the_folder_of_the_cache_are_named(tmp_path: Path) -> None:
    lines = doctor(NUMBA_DISABLE_JIT="1")
    assert "NUMBA_DISABLE_JIT is set" in lines["kernels"]
    assert lines["kernel cache"] == "none" and "NUMBA_DISABLE_JIT=1" in lines["variables"]
    folder = doctor(NUMBA_CACHE_DIR=str(tmp_path / "kernels"))["kernel cache"]
    assert folder.startswith(str(tmp_path / "kernels")) and folder.endswith(", writable")


def test_a_solver_that_crashes_does_not_end_the_command(real_solver: None, tmp_path: Path) -> None:
    (tmp_path / "pysplishsplash.py").write_text("import os; os.abort()")
    lines = doctor(PYTHONPATH=f"{tmp_path}:{ROOT}")
    assert "crashes when it is loaded (signal 6)" in lines["solver"] and "device" in lines


def test_missing_packages_have_the_command_that_installs_them() -> None:
    requirements = [
        "torch>=2.6",
        "torch>=99",
        "numpy>=2",
        'no-such-solver<3,>=2; extra == "solver"',
        'torch-no-scatter>=2; extra == "scatter"',
        'numpy<1; extra == "old"',
        'no-such-linter; extra == "dev"',
    ]
    assert missing(requirements) == [
        f"required: torch>=99 (installed: {metadata.version('torch')}); "
        "run `pip install fluidsnet`",
        f"extra old: numpy<1 (installed: {metadata.version('numpy')}); "
        "run `pip install 'fluidsnet[old]'`",
        "extra scatter: torch-no-scatter; "
        "run `pip install torch-cluster torch-scatter --no-build-isolation`",
        "extra solver: no-such-solver; run `pip install 'fluidsnet[solver]'`",
    ]


def test_arguments_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="1"):
        main(["doctor", "--fast"])
    assert "doctor takes no arguments, and was given `--fast`" in capsys.readouterr().err
    main(["doctor", "--help"])
    assert "bug report" in capsys.readouterr().out
