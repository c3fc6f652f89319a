"""Folders and configs of strangers: nothing of them runs, hangs, or commands a terminal."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from datamodules.generate.command import generate_command
from fluidsnet.child_process import python_code, python_module
from fluidsnet.errors import UserError
from fluidsnet.main import main
from fluidsnet.plain_yaml import read_yaml
from fluidsnet.reporting.table import markdown, write_csv

ROOT = Path(__file__).parents[1]
#: Ten lines that stand for 10¹⁰ values.
BOMB = "a0: &a0 [x]\n" + "".join(
    f"a{level}: &a{level} [{', '.join([f'*a{level - 1}'] * 10)}]\n" for level in range(1, 11)
)
LOOP = "a: &a [*a]\n"
DEEP = "[" * 20_000


@pytest.mark.parametrize("text", [BOMB, LOOP, DEEP])
def test_yaml_that_stands_for_too_much_is_refused(text: str) -> None:
    with pytest.raises(yaml.YAMLError, match=r"aliases stand for more|nested too deep"):
        read_yaml(text)


def test_yaml_with_few_aliases_is_read() -> None:
    assert read_yaml("a: &a [1, 2]\nb: *a\n") == {"a": [1, 2], "b": [1, 2]}


@pytest.mark.parametrize("command", ["fit", "generate", "trade"])
def test_a_config_that_stands_for_too_much_is_refused(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "config.yaml"
    config.write_text(BOMB)
    with pytest.raises(SystemExit) as ended:
        main([command, f"--config={config}", *(["--root=x"] if command == "generate" else [])])
    assert ended.value.code in (1, 2)
    said = capsys.readouterr().err
    assert "stand for more than 100,000 values" in " ".join(said.split())
    assert "Traceback" not in said


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A folder with a config that names a module beside it, whose import leaves a mark."""
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "config.yaml").write_text("model: {class_path: trap.Model}\ndata: {root: data}\n")
    (folder / "one_step.csv").write_text("one step ahead,skill\n=cmd|' /C calc'!A0,0.5\n")
    return folder


def trap(folder: Path, mark: Path, *names: str) -> None:
    for name in names:
        (folder / f"{name}.py").write_text(f"open({str(mark)!r}, 'a').write({name!r})\n")


def test_a_report_runs_nothing_that_a_run_names(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trap(run, tmp_path / "mark", "trap", "h5py", "yaml", "torch", "numpy")
    monkeypatch.chdir(run)
    monkeypatch.syspath_prepend(str(ROOT))
    main(["report", str(run)])
    assert not (tmp_path / "mark").exists()
    assert "trap.Model" in (run / "report" / "report.html").read_text()


def test_a_report_of_a_config_that_stands_for_too_much_says_so(run: Path) -> None:
    (run / "config.yaml").write_text(BOMB)
    main(["report", str(run)])
    assert "its aliases stand for more than" in (run / "report" / "report.md").read_text()


def test_a_report_takes_nothing_from_outside_the_run(run: Path, tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("password\n")
    (run / "one_step.md").symlink_to(tmp_path / "secret")
    main(["report", str(run)])
    text = (run / "report" / "report.md").read_text()
    assert "password" not in text
    assert "one_step.md cannot be read: it is a link to a file outside the folder" in text


def test_a_report_of_hostile_names_is_text(tmp_path: Path, run: Path) -> None:
    named = run.rename(tmp_path / "<script>alert(1)<\x1b[2Jrun")
    main(["report", str(named), f"--output={tmp_path / 'report'}"])
    page = (tmp_path / "report" / "report.html").read_text()
    text = (tmp_path / "report" / "report.md").read_text()
    assert "<script>alert" not in page and "<script>alert" not in text
    assert "\x1b" not in text
    cells = (tmp_path / "report" / "one_step.csv").read_text()
    assert "'=cmd|" in cells and "\n=cmd" not in cells


def test_cells_of_a_table_are_text(tmp_path: Path) -> None:
    table = markdown(["a|b", "=x"], [["<img src=x>", "1|2\n3"], ["\x1b]0;x\x07", "< 1 %"]])
    assert table.splitlines()[0].startswith(r"| a\|b")
    assert "<img" not in table and "\x1b" not in table and "< 1 %" in table
    assert r"1\|2 3" in table
    write_csv(tmp_path / "table.csv", ["=x"], [["@y"]])
    assert (tmp_path / "table.csv").read_text().split() == ["'=x", "'@y"]


def test_an_error_reaches_no_terminal_as_control_characters(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["inspect", str(tmp_path / "\x1b[2Jx.h5")])
    said = capsys.readouterr().err
    assert "\x1b" not in said and r"\x1b[2Jx.h5" in said


def test_child_processes_import_nothing_from_the_working_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trap(tmp_path, tmp_path / "mark", "h5py", "runpy", "json", "numpy")
    for command in (
        python_module("datamodules.generate.solver"),
        python_code("import runpy, json, h5py; print(h5py.__file__)"),
    ):
        done = subprocess.run(
            command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120
        )
        assert not (tmp_path / "mark").exists(), done
    assert done.returncode == 0 and str(tmp_path) not in done.stdout


@pytest.mark.usefixtures("real_solver")
def test_the_solver_imports_nothing_from_the_working_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trap(tmp_path, tmp_path / "mark", "h5py", "yaml", "numpy", "pysplishsplash")
    monkeypatch.chdir(tmp_path)
    counts = {"train": 1, "val": 0, "test": 0, "frames": 2, "particle_radius": 0.1}
    options = [f"--recipe.{name}={value}" for name, value in counts.items()]
    generate_command([f"--config={ROOT / 'configs/scene/sample.yaml'}", "--root=data", *options])
    assert (tmp_path / "data" / "train.h5").exists()
    assert not (tmp_path / "mark").exists()


def test_the_program_sets_the_import_path_of_its_children(tmp_path: Path) -> None:
    script = tmp_path / "fluidsnet"
    script.write_text(
        "import os, sys\nfrom fluidsnet.main import main\nsys.argv[1:] = ['--help']\nmain()\n"
        "print(os.environ['PYTHONSAFEPATH'])\n"
    )
    done = subprocess.run(
        [sys.executable, script], capture_output=True, text=True, check=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.stdout.endswith("1\n")


@pytest.mark.parametrize("encoding", ["ascii", "utf-8"])
def test_output_fits_any_terminal(encoding: str, sample: Path, tmp_path: Path) -> None:
    named = tmp_path / "tést.h5"
    shutil.copy(sample / "test.h5", named)
    done = subprocess.run(
        [sys.executable, "-m", "fluidsnet.main", "inspect", named],
        capture_output=True, check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT), "PYTHONIOENCODING": encoding},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert ("tést.h5" if encoding == "utf-8" else r"t\xe9st.h5") in done.stdout.decode()


@pytest.mark.parametrize(
    ("value", "expected"),
    [("--data.root=~/x", "--data.root={home}/x"), ("$PLACE/x", "here/x"), ("--a=b$PLACE", "")],
)
def test_home_and_variables_are_replaced_in_paths(
    value: str, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    from fluidsnet.main import _expanded

    monkeypatch.setenv("PLACE", "here")
    assert _expanded(value) == (expected.format(home=Path.home()) or value)


def test_a_name_that_is_too_long_is_one_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["inspect", "x" * 5000])
    assert ended.value.code == 1
    assert "File name too long" in capsys.readouterr().err


def test_yaml_of_a_loader_is_still_refused_by_its_own_error(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="holds no `model:`"):
        from fluidsnet.models.loading import has_weights

        (tmp_path / "x.yaml").write_text(BOMB)
        has_weights(tmp_path / "x.yaml")
