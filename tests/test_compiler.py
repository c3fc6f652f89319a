"""The compiler that `make setup` puts in front of the real one gives the same programs."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(shutil.which("g++") is None, reason="no g++")

COMPILER = Path(__file__).parents[1] / "tools" / "compiler.py"
FIRST = "#include <torch/script.h>\nint knn_cpu();\nint main() { return knn_cpu() + EIGHT - 8; }\n"
SECOND = "#include <torch/torch.h>\nint knn_cpu() { return VALUE; }\n"


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """An extension of two files, and headers of the names that torch's have."""
    for name, text in {
        "include/torch/script.h": "#pragma once\n#define VALUE 42\n",
        "include/torch/torch.h": "#pragma once\n#include <torch/script.h>\n",
        "include/Python.h": "#pragma once\n#define EIGHT 8\n",
        "csrc/knn.cpp": f"#include <Python.h>\n{FIRST}",
        "csrc/cpu/knn_cpu.cpp": SECOND,
    }.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    (tmp_path / "made").mkdir()
    return tmp_path


def built(package: Path, *sources: str, level: str = "-O2") -> str:
    """Compiles the files in this order, links and runs them; returns what was printed."""
    front = [sys.executable, str(COMPILER), str(package / "made"), "2"]
    printed, objects = "", []
    for source in sources:
        objects.append(str(package / f"{Path(source).stem}.o"))
        command = ["g++", level, "-Iinclude", "-DTORCH_EXTENSION_NAME=_knn_cpu"]
        done = subprocess.run(
            [*front, *command, "-c", source, "-o", objects[-1]],
            cwd=package, capture_output=True, text=True, check=True,
        )  # fmt: skip
        printed += done.stdout + done.stderr
    subprocess.run(["g++", *objects, "-o", "program"], cwd=package, check=True)
    assert subprocess.run([package / "program"]).returncode == 42
    return printed


def test_two_files_are_compiled_with_one_header(package: Path) -> None:
    assert built(package, "csrc/knn.cpp", "csrc/cpu/knn_cpu.cpp") == ""
    assert len([*(package / "made").glob("*.h.gch")]) == 1


def test_each_set_of_flags_has_a_header(package: Path) -> None:
    built(package, "csrc/cpu/knn_cpu.cpp", "csrc/knn.cpp")
    built(package, "csrc/cpu/knn_cpu.cpp", "csrc/knn.cpp", level="-O3")
    assert len([*(package / "made").glob("*.h.gch")]) == 2


def test_files_compile_where_the_header_does_not(package: Path) -> None:
    (package / "include/torch/torch.h").write_text('#error "no such torch"\n')
    (package / "csrc/cpu/knn_cpu.cpp").write_text(SECOND.replace("torch/torch.h", "torch/script.h"))
    printed = built(package, "csrc/knn.cpp", "csrc/cpu/knn_cpu.cpp")
    assert "no such torch" in printed and "compiling without it" in printed
    assert not [*(package / "made").glob("*.partial")]


def test_an_error_of_the_compiler_stays_one(package: Path) -> None:
    (package / "csrc/knn.cpp").write_text("wrong\n")
    with pytest.raises(subprocess.CalledProcessError):
        built(package, "csrc/knn.cpp", "csrc/cpu/knn_cpu.cpp")
