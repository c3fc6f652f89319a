"""Tests of the picture of an ablation: states, times, non-finite particles."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import torch
from lightning import LightningModule, Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from numpy.typing import NDArray
from PIL import Image
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from callbacks import Ablation, AblationPicture
from datamodules import SPHDataModule
from fluidsnet import FluidsNet
from fluidsnet.errors import UserError
from fluidsnet.export import Panel
from fluidsnet.features import NoGlobalFeature
from fluidsnet.integrator import Integrator
from fluidsnet.particles import Particles
from fluidsnet.reporting import rollout_frames
from fluidsnet.rollout import rollout
from fluidsnet.target import AccelerationTarget, Motion

#: Folder in the folder of a run for results on the sample.
RESULTS = "results/dam_break"
Pixels = NDArray[np.int16]
Drawn = list[tuple[list[Panel], dict[str, Any]]]


def trainer(folder: Path, *callbacks: Any, **changes: Any) -> Trainer:
    return Trainer(
        **{
            "accelerator": "cuda" if torch.cuda.is_available() else "cpu",
            "devices": 1,
            "logger": TensorBoardLogger(folder, name="run", version=""),
            "callbacks": list(callbacks),
            **dict.fromkeys(("enable_checkpointing", "enable_progress_bar"), False),
            **{"limit_train_batches": 2, "limit_val_batches": 0, "limit_test_batches": 1},
            **changes,
        }
    )


def made(sample: Path, **changes: Any) -> tuple[FluidsNet, SPHDataModule]:
    torch.manual_seed(0)
    source = SPHDataModule(sample, voxel_size=0.25)
    model = FluidsNet(source.grid_shape, global_feature=NoGlobalFeature, **changes)
    model.model.set_statistics(source.statistics, source.time_step)
    return model, source


def twin() -> Ablation:
    return Ablation("target", AccelerationTarget(), "other_target")


def pixels(path: Path) -> Pixels:
    with Image.open(path) as picture:
        return np.asarray(picture.convert("RGB")).astype(np.int16)


def crops(path: Path, rows: int, columns: int) -> list[list[Pixels]]:
    """Return the panels of a picture without titles and color bar."""
    picture = pixels(path)
    down, across = (picture.shape[0] - 24) // rows, (picture.shape[1] - 110) // columns
    return [
        [
            picture[row * down + 38 : (row + 1) * down, column * across + 24 :][:, : across - 24]
            for column in range(columns)
        ]
        for row in range(rows)
    ]


def fluid(crop: Pixels) -> int:
    """Return the number of pixels of particles, which are bluer than lines and background."""
    return int((crop[..., 2] > 160).sum())


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> Drawn:
    """Record the arguments of the renderer, which draws as usual."""
    found: Drawn = []
    draw = rollout_frames.side_by_side

    def record(path: Path, panels: list[Panel], *more: Any, **named: Any) -> None:
        found.append((panels, named))
        draw(path, panels, *more, **named)

    monkeypatch.setattr(rollout_frames, "side_by_side", record)
    return found


class Breaks(Integrator):
    """Integrator that sets a share of the particles to NaN in one of the network's steps."""

    def __init__(self, call: int, share: float) -> None:
        self.call, self.share, self.calls = call, share, 0

    def displacement(self, particles: Particles, motion: Motion) -> torch.Tensor:
        # Motions of the network have no displacement; those of the integrator floor have one.
        self.calls += motion.displacement is None
        moved = motion.velocity * 0.02
        if motion.displacement is None and self.calls == self.call:
            moved[: round(self.share * len(moved))] = torch.nan
        return moved


def test_truth_model_and_twin_are_drawn_at_each_time(
    sample: Path, tmp_path: Path, drawn: Drawn
) -> None:
    model, source = made(sample)
    trainer(tmp_path, twin(), AblationPicture()).test(model, source, verbose=False)
    path = tmp_path / "run" / RESULTS / "ablation.png"
    assert 50_000 < path.stat().st_size < 2e6
    assert pixels(path).shape[1] <= 2400
    ((panels, named),) = drawn
    with h5py.File(sample / "test.h5") as file:
        position, velocity = (file[f"00000/{of}"][()] for of in ("position", "velocity"))
    last = len(position) - 1
    at = [0, round(last / 4), round(last / 2), last]
    assert [panel.title for panel in panels] == [
        f"{who}, {0.02 * step:.2f} s" for who in ("truth", "model", "other target") for step in at
    ]
    for panel, step in zip(panels, at, strict=False):
        assert np.array_equal(panel.position, position[step])
        assert panel.speed == pytest.approx(np.linalg.norm(velocity[step], axis=1), rel=1e-5)
    # The scale is the truth's, without what a model does.
    fastest = np.linalg.norm(velocity[at], axis=2)
    assert named["speed_max"] == pytest.approx(np.quantile(fastest, 0.995), rel=1e-5)
    start = source.rollout_starts("test", [0], None, 1)[0].state
    for row, of in enumerate(model.named_models().values(), start=1):
        states = [start, *rollout(of, start, last)]
        for panel, step in zip(panels[4 * row : 4 * row + 4], at, strict=True):
            assert panel.position == pytest.approx(states[step].position.numpy(), abs=1e-4)
    truth, mine, others = crops(path, 3, 4)
    # Untrained, the twin's particles leave the box in the end.
    assert min(fluid(crop) for crop in (*truth, *mine, *others[:2])) > 2000
    # All start from one state, and none ends in another's.
    assert np.abs(truth[0] - mine[0]).max() < 30 and np.abs(truth[0] - others[0]).max() < 30
    ends = truth[3], mine[3], others[3]
    assert min(np.abs(ends[i] - ends[i - 1]).mean() for i in range(3)) > 2


def test_the_picture_is_the_same_each_time_and_in_tensorboard(sample: Path, tmp_path: Path) -> None:
    model, source = made(sample)
    runner = trainer(tmp_path, twin(), AblationPicture((0, 0.1)), max_epochs=1)
    runner.fit(model, source)
    path = tmp_path / "run" / RESULTS / "ablation.png"
    assert not path.exists()
    runner.test(model, source, verbose=False)
    once = path.rename(tmp_path / "once.png").read_bytes()
    runner.test(model, source, verbose=False)
    assert path.read_bytes() == once
    events = EventAccumulator(str(tmp_path / "run"), size_guidance={"images": 0}).Reload()
    logged = events.Images("ablation/speed")
    assert runner.global_step > 0 and {event.step for event in logged} == {runner.global_step}
    there = Image.open(io.BytesIO(logged[-1].encoded_image_string)).convert("RGB")
    assert np.array_equal(np.asarray(there), pixels(path))


def test_a_model_without_twins_is_drawn_with_the_truth(
    sample: Path, tmp_path: Path, drawn: Drawn
) -> None:
    model, source = made(sample)
    runner = trainer(tmp_path, AblationPicture([0.05]), logger=False, default_root_dir=tmp_path)
    runner.test(model, source, verbose=False)
    ((panels, _),) = drawn
    assert [panel.title for panel in panels] == ["truth, 0.04 s", "model, 0.04 s"]
    truth, mine = crops(tmp_path / RESULTS / "ablation.png", 2, 1)
    assert min(fluid(truth[0]), fluid(mine[0])) > 2000


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_what_is_not_finite_is_named_and_the_rest_is_drawn(
    sample: Path, tmp_path: Path, drawn: Drawn, share: float
) -> None:
    # The first call is that of the one batch; hence the third step of the rollout.
    model, source = made(sample, integrator=Breaks(4, share))
    trainer(tmp_path, AblationPicture((0, 0.05, 0.075, 1.0))).test(model, source, verbose=False)
    ((panels, _),) = drawn
    when = ("0.00 s", "0.04 s", "0.06 s, not finite", "0.80 s, not finite")
    assert [panel.title for panel in panels[4:]] == [f"model, {words}" for words in when]
    gone = np.isnan(panels[6].position).any(axis=1)
    assert gone.sum() == round(share * len(gone))
    assert np.isfinite(panels[5].position).all()
    truth, mine = crops(tmp_path / "run" / RESULTS / "ablation.png", 2, 4)
    assert min(fluid(crop) for crop in (*truth, *mine[:2])) > 2000
    left = fluid(mine[2])
    assert left == 0 if share == 1 else 500 < left < fluid(mine[1])


def test_a_velocity_that_is_not_finite_leaves_its_particle_out() -> None:
    position, velocity = torch.rand(4, 3), torch.ones(4, 3)
    velocity[1, 2], velocity[2, 0], velocity[3] = torch.inf, torch.nan, 1e30
    frame = rollout_frames.Frame(position.numpy(), velocity.numpy(), position[:0].numpy())
    panel = rollout_frames.panel("a_b", 0.5, frame)
    assert panel.title == "a b, 0.50 s, not finite"
    assert np.isfinite(panel.position).all(axis=1).tolist() == [True, False, False, True]
    assert panel.speed[3] == pytest.approx(3**0.5 * 1e30)


def test_a_model_that_blows_up_leaves_the_others_colors(sample: Path, tmp_path: Path) -> None:
    found = []  # The untrained twin gets ever faster; the scale is the truth's.
    for name, more in (("alone", []), ("beside", [twin()])):
        model, source = made(sample)
        runner = trainer(tmp_path / name, *more, AblationPicture((0, 0.25, 0.5)))
        runner.test(model, source, verbose=False)
        rows = crops(tmp_path / name / "run" / RESULTS / "ablation.png", 2 + len(more), 3)
        found.append([crop for row in rows[:2] for crop in row])
    # Each picture has 256 colors of its own, which differ in single pixels, not on average.
    off = [abs((one - two).mean()) for one, two in zip(*found, strict=True)]
    assert max(off) < 1


def test_the_first_of_two_draws_in_the_first_process(
    sample: Path, tmp_path: Path, drawn: Drawn, monkeypatch: pytest.MonkeyPatch
) -> None:
    model, source = made(sample)
    first, second = AblationPicture([0, 0.05]), AblationPicture([0.1])
    runner = trainer(tmp_path, first, second)
    runner.test(model, source, verbose=False)
    ((panels, named),) = drawn
    assert len(panels) == 4 and named["columns"] == 2
    first.on_test_epoch_end(runner, model)
    assert len(drawn) == 2
    monkeypatch.setattr(Trainer, "is_global_zero", False)
    monkeypatch.setattr(rollout_frames, "rollout", None)
    first.on_test_epoch_end(runner, model)
    assert len(drawn) == 2


@pytest.mark.parametrize("times", [(), (-0.1,), (0.5, 1.5), (float("nan"),)])
def test_times_that_cannot_be_used(times: tuple[float, ...]) -> None:
    words = "give at least one share of the truth's length, from 0 to 1."
    with pytest.raises(UserError) as raised:
        AblationPicture(times)
    assert str(raised.value) == f"AblationPicture: times is {list(times)}; {words}"


def test_another_module_or_other_data_are_refused(sample: Path, tmp_path: Path) -> None:
    picture = AblationPicture()
    runner = trainer(tmp_path, picture)
    with pytest.raises(UserError, match="AblationPicture needs the model FluidsNet"):
        picture.setup(runner, LightningModule(), "test")
    with pytest.raises(UserError, match="a data module with rollout_starts"):
        picture.setup(runner, made(sample)[0], "test")
    picture.setup(runner, made(sample)[0], "fit")
