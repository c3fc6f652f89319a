"""Tests of ``fluidsnet export``."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import meshio
import numpy as np
import pytest
from pxr import Usd, UsdGeom

import fluidsnet
from datamodules.convert.bgeo_file import read_bgeo
from fluidsnet.export import TrajectoryFile
from fluidsnet.main import main
from fluidsnet.studies.export.data_file import data_frames


@pytest.fixture
def source(sample: Path) -> str:
    return str(sample / "test.h5")


def refusal(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Run the command, which must fail with one message; return that."""
    with pytest.raises(SystemExit) as ended:
        main(["export", *arguments])
    assert ended.value.code == 1
    return capsys.readouterr().err


@pytest.mark.parametrize("suffix", ["ply", "bgeo"])
def test_a_folder_of_particles(
    source: str, suffix: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "dam"
    part = ["--simulation", "00000", "--first", "20", "--last", "30", "--every", "5"]
    main(["export", source, "--to", suffix, "--output", str(folder), *part])
    assert capsys.readouterr().out == f"{folder}: 3 frames of {source}, /00000.\n"
    names = [f"dam.000{index}.{suffix}" for index in range(3)]
    assert sorted(os.listdir(folder)) == [*names, f"dam.{suffix}.series"]
    assert os.listdir(tmp_path) == ["dam"]
    series = json.loads((folder / f"dam.{suffix}.series").read_text())
    assert [file["name"] for file in series["files"]] == names
    assert [file["time"] for file in series["files"]] == pytest.approx([0.4, 0.5, 0.6])
    for name, frame in zip(names, data_frames(Path(source), None).select(20, 30, 5), strict=True):
        path = folder / name
        found = read_bgeo(path).position if suffix == "bgeo" else meshio.read(path).points
        np.testing.assert_array_equal(found, frame.position)


def test_a_shorter_second_run_leaves_no_file_of_the_first(
    source: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["export", source, "--output", str(tmp_path / "dam")]
    main([*command, "--to", "ply"])
    main([*command, "--to", "bgeo", "--last", "1"])
    assert "replaces an older export" in capsys.readouterr().out
    names = ["dam.0000.bgeo", "dam.0001.bgeo", "dam.bgeo.series"]
    assert sorted(os.listdir(tmp_path / "dam")) == names
    assert os.listdir(tmp_path) == ["dam"]


def test_a_folder_with_other_files_is_refused(
    source: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["export", source, "--to", "ply", "--last", "1", "--output", str(tmp_path / "dam")]
    main(command)
    (tmp_path / "dam" / "notes.txt").write_text("mine")
    assert "choose another --output" in refusal(command[1:], capsys)
    assert len(os.listdir(tmp_path / "dam")) == 4
    (tmp_path / "file").write_text("mine")
    command[-1] = str(tmp_path / "file")
    assert "choose another --output" in refusal(command[1:], capsys)
    assert (tmp_path / "file").read_text() == "mine"


def test_a_failure_keeps_the_older_meshes(
    source: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--to", "surface", "--mesh.cube_size", "1", "--output", str(tmp_path / "mesh")]
    main(["export", source, *arguments, "--every", "20", "--workers", "1"])
    before = {path.name: path.read_bytes() for path in (tmp_path / "mesh").iterdir()}
    blown = tmp_path / "blown.vtkhdf"
    with TrajectoryFile(blown, 8) as file:
        for time, place in ((0.0, 1.0), (1.0, np.inf)):
            position = np.full((8, 3), place)
            file.append(time, position, {"velocity": np.zeros((8, 3))})
    arguments += ["--workers", "1"]
    assert "--radius" in refusal([str(blown), *arguments], capsys)
    assert "no finite position" in refusal([str(blown), *arguments, "--radius", "0.1"], capsys)
    assert {path.name: path.read_bytes() for path in (tmp_path / "mesh").iterdir()} == before
    assert sorted(os.listdir(tmp_path)) == ["blown.vtkhdf", "mesh"]


def test_a_usd_file_with_a_surface(
    source: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "dam.usdc"
    options = ["--surface", "--every", "20", "--mesh.cube_size", "1", "--fps", "24"]
    for _ in range(2):
        main(["export", source, "--to", "usd", "--output", str(path), *options])
    assert "replaces an older export" in capsys.readouterr().out
    stage = Usd.Stage.Open(str(path))
    codes = [0, 9.6, 19.2]
    for name in ("particles", "surface"):
        prim = UsdGeom.PointBased(stage.GetPrimAtPath(f"/fluid/{name}"))
        assert prim.GetPointsAttr().GetTimeSamples() == pytest.approx(codes)


@pytest.mark.parametrize(
    ("limit", "options"),
    [(100, ["--to", "usd", "--output", "a.usdc"]), (12, ["--to", "surface", "--output", "a"])],
)
def test_a_full_disk_is_one_sentence(
    source: str, limit: int, options: list[str], tmp_path: Path
) -> None:
    # A limit of the size of files, KiB, stands for the disk.
    command = [sys.executable, "-m", "fluidsnet.main", "export", source, *options]
    run = f"ulimit -f {limit}; exec {shlex.join(command)} --workers 1"
    result = subprocess.run(
        ["bash", "-c", run],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(Path(fluidsnet.__file__).parents[1])},
        capture_output=True,
        text=True,
    )
    assert result.returncode == 1
    assert "cannot be written" in result.stderr and "Traceback" not in result.stderr
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--to", "usd", "--output", "a.abc"], "must end in .usdc"),
        (["--to", "ply", "--output", "a", "--surface"], "--to surface"),
        (["--to", "ply", "--output", "a", "--fps", "24"], "--fps is for --to usd"),
        (["--to", "ply", "--output", "a", "--radius", "-1"], "--radius is -1"),
        (["--to", "surface", "--output", "a", "--workers", "0"], "--workers is 0"),
        (["--to", "ply", "--output", "a", "--simulation", "7"], "there is no simulation 7"),
        (["--to", "ply", "--output", "a", "--first", "41"], "frames 0 to 40"),
        (["--to", "fbx", "--output", "a"], "Got value: fbx"),
        (["--to", "ply"], "output"),
    ],
)
def test_options_that_cannot_be_used(
    source: str,
    options: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert message in refusal([source, *options], capsys)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("module", "package", "options"),
    [
        ("pxr", "usd-core", ["--to", "usd", "--output", "a.usdc"]),
        ("meshio", "meshio", ["--to", "ply", "--output", "a"]),
        ("pysplashsurf", "pysplashsurf", ["--to", "surface", "--output", "a", "--workers", "1"]),
    ],
)
def test_a_missing_package_is_named(
    source: str,
    module: str,
    package: str,
    options: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in [name for name in sys.modules if name.partition(".")[0] == module]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, module, None)  # an import of it fails
    message = refusal([source, *options], capsys)
    assert f"The package {package} cannot be loaded" in message
    assert "pip install 'fluidsnet[export]'" in message
    assert os.listdir(tmp_path) == []
