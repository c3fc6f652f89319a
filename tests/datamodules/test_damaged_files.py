"""Files whose values, storage or links cannot be used, and unusual ones that can."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch

from datamodules.inspection import summarize
from datamodules.needs import grid_shape
from datamodules.reader import FrameReader, read_state
from datamodules.rollout_starts import HDF5RolloutStarts
from datamodules.sph import SPHDataModule
from fluidsnet import load
from fluidsnet.errors import UserError
from fluidsnet.main import main
from fluidsnet.reporting.file_places import file_places
from fluidsnet.studies.plan.command import inspect_command

Change = Callable[[h5py.File], None]
#: A corner of a box in map coordinates, m; no number of float32.
FAR = np.array([500_000.13, 0.0, 5_000_000.27])


@pytest.fixture
def file(sample: Path, tmp_path: Path) -> Path:
    shutil.copy(sample / "test.h5", tmp_path / "test.h5")
    return tmp_path / "test.h5"


def changed(file: Path, change: Change) -> Path:
    with h5py.File(file, "r+") as handle:
        change(handle)
    return file


def replaced(group: h5py.Group, name: str, **options: object) -> None:
    """Store a data set anew with other options."""
    values = options.pop("data", group[name][()])
    del group[name]
    group.create_dataset(name, data=values, **options)


def lost(handle: h5py.File) -> None:
    handle["00000/velocity"][7, 3, 1] = np.nan


def hollow(handle: h5py.File) -> None:
    group = handle["00000"]
    shape = group["position"].shape
    for name in ("position", "velocity"):
        del group[name]
        group.create_dataset(
            name, (shape[0], 10**9, 3), np.float32, chunks=(1, 10**6, 3), compression="gzip"
        )


def unwritten(handle: h5py.File) -> None:
    del handle["00000/solid_position"]
    handle["00000"].create_dataset("solid_position", (100, 3), np.float32)


def linked(handle: h5py.File) -> None:
    del handle["00000/velocity"]
    handle["00000/velocity"] = h5py.ExternalLink("/etc/passwd", "/velocity")


def linked_group(handle: h5py.File) -> None:
    handle["00001"] = h5py.ExternalLink("other.h5", "/00000")


def virtual(handle: h5py.File) -> None:
    shape = handle["00000/velocity"].shape
    layout = h5py.VirtualLayout(shape, np.float32)
    layout[:] = h5py.VirtualSource("other.h5", "velocity", shape)
    del handle["00000/velocity"]
    handle["00000"].create_virtual_dataset("velocity", layout)


def attribute(name: str, value: object) -> Change:
    def change(handle: h5py.File) -> None:
        for owner in (handle, handle["00000"]):
            if name in owner.attrs:
                owner.attrs[name] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (hollow, "/00000/position has shape .*chunks were never written: it holds less than"),
        (unwritten, r"/00000/solid_position has shape \(100, 3\) and was never written"),
        (linked, r"/00000/velocity is a link to another file, /etc/passwd; copy"),
        (linked_group, r"/00001 is a link to another file, other.h5; copy"),
        (virtual, "/00000/velocity takes its values from another file"),
        (attribute("density0", -1000.0), "density0 is -1000.0; it must be above zero"),
        (attribute("viscosity", -0.01), "viscosity is -0.01; it must be at least zero"),
        (attribute("support_radius", 0.001), "particles would have no neighbors"),
        (attribute("gravity", [0.0, np.nan, 0.0]), "it must be finite"),
        (attribute("domain_upper", [np.inf, 1.0, 1.0]), "it must be finite"),
    ],
)
def test_what_is_refused_before_anything_is_read(file: Path, change: Change, message: str) -> None:
    with pytest.raises(UserError, match=message):
        FrameReader(changed(file, change))


def test_a_value_that_is_not_finite_is_named(file: Path) -> None:
    reader = FrameReader(changed(file, lost))
    reader.state("00000", 6, 1)
    for read in (lambda: reader.state("00000", 7, 1), lambda: reader.fluid("00000", 7)):
        with pytest.raises(UserError, match=r"1 of the numbers of velocity in frame 7 of /00000"):
            read()
    # Also where it is the truth of a rollout.
    start = HDF5RolloutStarts(reader, 1)[0]
    with pytest.raises(UserError, match="frame 7 of /00000 are not finite"):
        start.truth[7]
    summary = summarize(file)
    assert summary.damaged
    assert "1 frames are not finite, or beyond 1e+30, the first is 7" in summary.text
    with pytest.raises(UserError, match=r"damaged, as above: .*\.h5"):
        inspect_command([str(file)])


def test_training_ends_at_a_value_that_is_not_finite(
    sample: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / "data"
    shutil.copytree(sample, root)
    changed(root / "val.h5", lost)
    configs = Path(__file__).parents[2] / "configs"
    with pytest.raises(SystemExit) as ended:
        main(
            [
                "fit",
                *(f"--config={configs / it}" for it in ("model/paper.yaml", "data/sample.yaml")),
                *(
                    f"--data.init_args.root={root}",
                    "--trainer.max_steps=1",
                    "--trainer.logger=false",
                ),
                *("--trainer.enable_progress_bar=false", f"--trainer.default_root_dir={tmp_path}"),
            ]
        )
    message = capsys.readouterr().err
    assert ended.value.code == 1
    assert "val.h5: 1 of the numbers of velocity in frame 7 of /00000 are not finite" in message


@pytest.mark.parametrize("kind", [">f4", ">f8", "<f8", np.longdouble, np.float16])
def test_any_type_of_numbers_is_read(file: Path, kind: str) -> None:
    before = FrameReader(file).state("00000", 5, 1)

    def stored(handle: h5py.File) -> None:
        for name in ("position", "velocity", "solid_position"):
            values = handle[f"00000/{name}"][()].astype(kind)
            replaced(handle["00000"], name, data=values)

    after = FrameReader(changed(file, stored)).state("00000", 5, 1)
    exact = 0 if np.dtype(kind).itemsize > 2 else 2e-3
    for name in ("position", "velocity", "solid_position"):
        one, two = getattr(before, name), getattr(after, name)
        assert two.dtype == torch.float32
        torch.testing.assert_close(two, one, atol=exact, rtol=0)


def moved_far(handle: h5py.File) -> None:
    for owner in (handle, handle["00000"]):
        for name in ("domain_lower", "domain_upper"):
            if name in owner.attrs:
                owner.attrs[name] = owner.attrs[name] + FAR
    for group in (handle[name] for name in handle):
        for name in ("position", "solid_position"):
            replaced(group, name, data=group[name][()].astype(np.float64) + FAR)


def test_a_box_far_from_zero_steps_as_one_at_zero(sample: Path, file: Path) -> None:
    model = load("box_drops")
    near = read_state(sample / "test.h5", 0.02)
    far = read_state(changed(file, moved_far), 0.02)
    assert (far.position - near.position).abs().max() < 1e-6
    for _ in range(3):
        near, far = model.step(near), model.step(far)
    assert (far.position - near.position).abs().max() < 1e-5
    # Written back, it is where it was; float32 would tell places 0.5 m apart.
    places = file_places(far.position, far)
    assert places.dtype == np.float64
    assert np.abs(places - FAR - near.position.numpy()).max() < 1e-5
    assert file_places(near.position, near).dtype == np.float32
    assert "nothing suspicious" in summarize(file).text


def test_coordinates_that_float32_has_rounded_are_suspicious(file: Path) -> None:
    def rounded(handle: h5py.File) -> None:
        moved_far(handle)
        for group in (handle[name] for name in handle):
            replaced(group, "position", data=group["position"][()].astype(np.float32))

    text = summarize(changed(file, rounded)).text
    assert "float32 tells places 0.5 m apart so far from zero; store positions as float64" in text


def test_a_grid_of_too_many_cells_is_refused(sample: Path) -> None:
    source = SPHDataModule(sample, voxel_size=1e-4)
    with pytest.raises(UserError, match=r"data.voxel_size is 0.0001 m, which gives [\d,]+ x "):
        grid_shape(source.scene, source.voxel_size)
