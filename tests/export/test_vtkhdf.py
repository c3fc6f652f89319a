"""Tests of trajectory files, read back with the reader of VTK and with h5py."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOHDF import vtkHDFReader

from fluidsnet.errors import NotWritten, UserError
from fluidsnet.export import TrajectoryFile, read_field_data, read_frame, vtkhdf
from fluidsnet.export.vtkhdf import read_attributes

N = 37
STEPS = 5


def state(step: int, particles: int = N) -> tuple[NDArray[np.float32], dict[str, NDArray[Any]]]:
    rng = np.random.default_rng(step)
    position = rng.normal(size=(particles, 3)).astype(np.float32)
    velocity = rng.normal(size=(particles, 3)).astype(np.float32)
    row = np.arange(particles, dtype=np.int32) + step
    return position, {"velocity": velocity, "row number": row}


def time(step: int) -> float:
    return 0.1 + 0.02 * step


def write(path: Path, steps: int = STEPS, particles: int = N) -> None:
    with TrajectoryFile(path, particles=particles) as file:
        for step in range(steps):
            position, point_data = state(step, particles)
            file.append(time(step), position, point_data, {"energy": 10.0 * step, "lost": -step})


def vtk_reader(path: Path) -> Any:
    reader = vtkHDFReader()
    reader.SetFileName(str(path))
    assert reader.CanReadFile(str(path))
    reader.UpdateInformation()
    return reader


def array(values: Any) -> NDArray[Any]:
    return np.asarray(vtk_to_numpy(values))  # type: ignore[no-untyped-call]


def vtk_step(reader: Any, step: int) -> Any:
    reader.SetStep(step)
    reader.Update()
    return reader.GetOutput()


@pytest.mark.parametrize("particles", [1, N])
def test_vtk_reads_every_step(tmp_path: Path, particles: int) -> None:
    path = tmp_path / "rollout.vtkhdf"
    write(path, particles=particles)
    reader = vtk_reader(path)
    assert reader.GetNumberOfSteps() == STEPS
    for step in (0, 3, STEPS - 1, 1):  # there and back, as a user drags the time
        position, point_data = state(step, particles)
        output = vtk_step(reader, step)
        assert reader.GetTimeValue() == pytest.approx(time(step))
        assert output.GetNumberOfVerts() == output.GetNumberOfCells() == particles
        assert [output.GetCell(i).GetPointId(0) for i in range(particles)] == [*range(particles)]
        np.testing.assert_array_equal(array(output.GetPoints().GetData()), position)
        arrays = output.GetPointData()
        names = {arrays.GetArrayName(i) for i in range(arrays.GetNumberOfArrays())}
        assert names == set(point_data)
        for name, values in point_data.items():
            found = array(arrays.GetArray(name))
            assert found.dtype == values.dtype
            np.testing.assert_array_equal(found, values)
        for name, value in (("energy", 10.0 * step), ("lost", -step)):
            column = output.GetFieldData().GetArray(name)
            assert (column.GetNumberOfTuples(), column.GetTuple(0)) == (1, (value,))


def test_vtk_offers_the_times(tmp_path: Path) -> None:
    path = tmp_path / "rollout.vtkhdf"
    write(path)
    reader = vtk_reader(path)
    key = reader.GetExecutive().TIME_STEPS()
    times = reader.GetOutputInformation(0).Get(key)
    np.testing.assert_allclose(times, [time(step) for step in range(STEPS)])


def test_attributes_are_kept_and_vtk_reads_the_file(tmp_path: Path) -> None:
    path = tmp_path / "rollout.vtkhdf"
    attributes = {"particle_radius": 0.025, "gravity": [0.0, -9.81, 0.0]}
    with TrajectoryFile(path, N, attributes) as file:
        file.append(0.0, *state(0))
    found = read_attributes(path)
    assert set(found) == set(attributes)
    for name, value in attributes.items():
        np.testing.assert_array_equal(found[name], value)
    output = vtk_step(vtk_reader(path), 0)
    np.testing.assert_array_equal(array(output.GetPoints().GetData()), state(0)[0])


def test_h5py_reads_what_was_written(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "folder" / "rollout.vtkhdf"
    write(path)
    assert os.listdir(path.parent) == [path.name]
    columns = read_field_data(path)
    assert set(columns) == {"time", "energy", "lost"}
    np.testing.assert_allclose(columns["time"], [time(step) for step in range(STEPS)])
    np.testing.assert_array_equal(columns["energy"], 10.0 * np.arange(STEPS))
    for step, same in ((0, 0), (2, 2), (-1, STEPS - 1)):
        position, point_data = read_frame(path, step)
        expected_position, expected = state(same)
        np.testing.assert_array_equal(position, expected_position)
        assert set(point_data) == set(expected)
        for name, values in expected.items():
            np.testing.assert_array_equal(point_data[name], values)


def test_positions_alone_are_enough(tmp_path: Path) -> None:
    path = tmp_path / "rollout.vtkhdf"
    with TrajectoryFile(path, particles=N) as file:
        file.append(0.0, np.ones((N, 3)))
    assert vtk_step(vtk_reader(path), 0).GetNumberOfPoints() == N
    assert set(read_field_data(path)) == {"time"}
    assert read_frame(path, 0)[1] == {}


def test_a_frame_is_a_compressed_chunk_and_vertices_are_stored_once(tmp_path: Path) -> None:
    path = tmp_path / "rollout.vtkhdf"
    write(path)
    with h5py.File(path) as file:
        for name in ("Points", "PointData/velocity"):
            dataset = file["VTKHDF"][name]
            assert dataset.shape == (STEPS * N, 3)
            assert dataset.chunks == (N, 3)
            assert (dataset.compression, dataset.shuffle) == ("gzip", True)
        assert file["VTKHDF/Vertices/Connectivity"].shape == (N,)
        assert not file["VTKHDF/Steps/CellOffsets"][...].any()


def test_an_exception_keeps_the_steps_before_it(tmp_path: Path) -> None:
    path = tmp_path / "rollout.vtkhdf"
    with pytest.raises(KeyboardInterrupt), TrajectoryFile(path, particles=N) as file:
        for step in range(3):
            file.append(time(step), *state(step))
        raise KeyboardInterrupt
    assert os.listdir(tmp_path) == [path.name]
    assert vtk_reader(path).GetNumberOfSteps() == 3
    np.testing.assert_array_equal(read_frame(path, -1)[0], state(2)[0])


def test_an_append_cut_short_leaves_no_half_step(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "rollout.vtkhdf"

    def ctrl_c(self: Any, key: Any, value: Any) -> None:
        if self.name.endswith("velocity"):
            raise KeyboardInterrupt
        written(self, key, value)

    written = h5py.Dataset.__setitem__
    with pytest.raises(KeyboardInterrupt), TrajectoryFile(path, particles=N) as file:
        file.append(time(0), *state(0))
        monkeypatch.setattr(h5py.Dataset, "__setitem__", ctrl_c)
        file.append(time(1), *state(1))
    with h5py.File(path) as whole:
        assert whole["VTKHDF/Points"].shape == whole["VTKHDF/PointData/velocity"].shape == (N, 3)
    assert vtk_reader(path).GetNumberOfSteps() == 1
    np.testing.assert_array_equal(read_frame(path, 0)[1]["velocity"], state(0)[1]["velocity"])


def test_a_step_whose_flush_is_cut_short_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "rollout.vtkhdf"

    def ctrl_c(self: Any) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), TrajectoryFile(path, particles=N) as file:
        file.append(time(0), *state(0))
        monkeypatch.setattr(h5py.File, "flush", ctrl_c)
        file.append(time(1), *state(1))
    assert vtk_reader(path).GetNumberOfSteps() == 1
    np.testing.assert_array_equal(read_frame(path, -1)[0], read_frame(path, 0)[0])


def test_what_hdf5_cannot_write_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "rollout.vtkhdf"

    def full(self: Any) -> None:
        raise RuntimeError("Unable to flush (file write failed: filename = 'x', errno = 28, …)")

    with TrajectoryFile(path, particles=N) as file:
        monkeypatch.setattr(h5py.File, "flush", full)
        with pytest.raises(NotWritten, match=r"rollout\.vtkhdf cannot be written: No space left"):
            file.append(time(0), *state(0))
    assert [it.name for it in tmp_path.iterdir()] == ["rollout.vtkhdf.tmp"]


def test_a_killed_process_leaves_its_steps_in_the_temporary_file(tmp_path: Path) -> None:
    path = tmp_path / "rollout.vtkhdf"
    script = f"""
import os, numpy as np
from fluidsnet.export.vtkhdf import TrajectoryFile
with TrajectoryFile({str(path)!r}, particles=4) as file:
    for step in range(3):
        file.append(step, np.full((4, 3), step), {{}}, {{"n": step}})
    os._exit(9)
"""
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 9
    assert os.listdir(tmp_path) == ["rollout.vtkhdf.tmp"]
    temporary = tmp_path / "rollout.vtkhdf.tmp"
    np.testing.assert_array_equal(read_field_data(temporary)["n"], [0, 1, 2])
    np.testing.assert_array_equal(read_frame(temporary, -1)[0], np.full((4, 3), 2))


def test_without_a_step_there_is_no_file_and_an_older_one_stays(tmp_path: Path) -> None:
    path = tmp_path / "rollout.vtkhdf"
    write(path, steps=2)
    with pytest.raises(KeyError), TrajectoryFile(path, particles=3):
        raise KeyError
    assert os.listdir(tmp_path) == [path.name]
    assert len(read_field_data(path)["time"]) == 2


def test_the_first_step_fixes_the_names(tmp_path: Path) -> None:
    position, point_data = state(0)
    with TrajectoryFile(tmp_path / "rollout.vtkhdf", particles=N) as file:
        file.append(0.0, position, point_data, {"energy": 1.0})
        with pytest.raises(ValueError, match="FieldData/energy, PointData/velocity"):
            file.append(1.0, position, {"row number": point_data["row number"]})
        with pytest.raises(ValueError, match="PointData/density"):
            file.append(1.0, position, {**point_data, "density": np.ones(N)}, {"energy": 1.0})
        file.append(1.0, position, point_data, {"energy": 2.0})
    np.testing.assert_array_equal(read_field_data(file.path)["energy"], [1.0, 2.0])


@pytest.mark.parametrize(
    ("position", "point_data", "message"),
    [
        (np.zeros((N + 1, 3)), {"a": np.zeros(N)}, "Points has shape"),
        (np.zeros((N, 2)), {"a": np.zeros(N)}, "Points has shape"),
        (np.zeros((N, 3)), {"a": np.zeros(N - 1)}, "PointData/a has shape"),
        (np.zeros((N, 3)), {"a": np.zeros((N, 3))}, "PointData/a has shape"),
        (np.zeros((N, 3)), {"a": np.zeros(N, bool)}, "PointData/a holds bool"),
        (np.zeros((N, 3)), {"a": np.zeros(N, complex)}, "PointData/a holds complex"),
    ],
)
def test_what_does_not_fit_is_refused(
    tmp_path: Path, position: NDArray[Any], point_data: dict[str, NDArray[Any]], message: str
) -> None:
    with TrajectoryFile(tmp_path / "rollout.vtkhdf", particles=N) as file:
        file.append(0.0, np.zeros((N, 3)), {"a": np.zeros(N)})
        with pytest.raises(ValueError, match=message):
            file.append(1.0, position, point_data)
    assert len(read_field_data(file.path)["time"]) == 1


def test_fractions_are_not_cut_to_whole_numbers(tmp_path: Path) -> None:
    with TrajectoryFile(tmp_path / "rollout.vtkhdf", particles=N) as file:
        file.append(0.0, np.zeros((N, 3)), {"a": np.zeros(N, int)})
        with pytest.raises(ValueError, match="PointData/a holds float64"):
            file.append(1.0, np.zeros((N, 3)), {"a": np.full(N, 0.5)})


@pytest.mark.parametrize("name", ["", ".", "a/b", "time"])
def test_names_that_a_file_cannot_have(tmp_path: Path, name: str) -> None:
    refused = pytest.raises(ValueError, match="cannot be named")
    with TrajectoryFile(tmp_path / "rollout.vtkhdf", particles=N) as file, refused:
        file.append(0.0, np.zeros((N, 3)), {}, {name: 1.0})
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("second", [0.0, -1.0, np.nan, np.inf])
def test_time_goes_forward(tmp_path: Path, second: float) -> None:
    with TrajectoryFile(tmp_path / "rollout.vtkhdf", particles=N) as file:
        file.append(0.0, np.zeros((N, 3)))
        with pytest.raises(ValueError, match="time must be later"):
            file.append(second, np.zeros((N, 3)))


def test_a_state_that_blew_up_is_kept_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "rollout.vtkhdf"
    position = np.full((N, 3), np.nan, dtype=np.float32)
    with TrajectoryFile(path, particles=N) as file:
        file.append(0.0, position, {}, {"energy": np.inf})
    assert np.isnan(read_frame(path, 0)[0]).all()
    assert np.isinf(read_field_data(path)["energy"][0])


def test_other_files_give_one_clear_sentence(tmp_path: Path) -> None:
    whole = tmp_path / "whole.vtkhdf"
    write(whole)
    cut = tmp_path / "cut.vtkhdf"
    cut.write_bytes(whole.read_bytes()[:3000])
    text = tmp_path / "text.vtkhdf"
    text.write_text("not HDF5")
    foreign = tmp_path / "foreign.vtkhdf"
    with h5py.File(foreign, "w") as file:
        file["00000/position"] = np.zeros((2, N, 3))
    lacking = tmp_path / "lacking.vtkhdf"
    lacking.write_bytes(whole.read_bytes())
    with h5py.File(lacking, "a") as file:
        del file["VTKHDF/Points"], file["VTKHDF/Steps/Values"]
    for path, message in (
        (tmp_path / "absent.vtkhdf", "no such file"),
        (cut, "not a whole trajectory file"),
        (text, "not a whole trajectory file"),
        (foreign, "no group /VTKHDF/Steps"),
        (lacking, "not a whole trajectory file"),
    ):
        for read in (lambda path: read_frame(path, 0), read_field_data):
            with pytest.raises(UserError, match=message) as caught:
                read(path)
            assert str(path) in str(caught.value)


@pytest.mark.parametrize("step", [STEPS, -STEPS - 1])
def test_a_step_that_is_not_there(tmp_path: Path, step: int) -> None:
    path = tmp_path / "rollout.vtkhdf"
    write(path)
    with pytest.raises(UserError, match=f"no step {step}; the file has {STEPS} steps"):
        read_frame(path, step)


def test_a_name_or_place_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"must end in \.vtkhdf"):
        TrajectoryFile(tmp_path / "rollout.h5", particles=N)
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="cannot be written"):
        TrajectoryFile(tmp_path / "file" / "rollout.vtkhdf", particles=N).__enter__()


def test_append_outside_the_block_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="with"):
        TrajectoryFile(tmp_path / "rollout.vtkhdf", particles=N).append(0.0, np.zeros((N, 3)))


def test_it_needs_neither_torch_nor_vtk() -> None:
    tree = ast.parse(Path(vtkhdf.__file__).read_text())
    imported = {
        name.split(".")[0]
        for node in ast.walk(tree)
        for name in (
            [alias.name for alias in node.names]
            if isinstance(node, ast.Import)
            else [node.module or ""]
            if isinstance(node, ast.ImportFrom)
            else []
        )
    }
    assert imported.isdisjoint({"torch", "vtk", "vtkmodules", "lightning", "matplotlib"})
