"""SPHDataModule: batches of transitions and rollout starts from HDF5 files."""

from __future__ import annotations

import math
import os
import random
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import torch
from lightning import LightningDataModule
from lightning.pytorch.utilities import rank_zero_warn
from torch.utils.data import DataLoader, Sampler

from datamodules.augmentation import Augmentation
from datamodules.needs import grid_shape, varying
from datamodules.order import TrainingOrder, each_once, progress_of
from datamodules.reader import FrameReader
from datamodules.rollout_starts import HDF5RolloutStarts
from datamodules.schema import SPLITS
from datamodules.transitions import Sample, TransitionDataset, samples_in, statistics
from fluidsnet.distributed import processes
from fluidsnet.errors import UserError
from fluidsnet.particles import RolloutStart, Transitions
from fluidsnet.scene import Scene
from fluidsnet.statistics import Statistics


class SPHDataModule(LightningDataModule):
    """Data module of a folder with train.h5, val.h5 and test.h5 (see `datamodules.schema`).

    Args:
        root: Path of the folder.
        voxel_size: Edge of a cell of the network's background grid, m. It grows with the size
            of the scene (paper, section 5.5).
        stride: Frames from a state to the next; the time step of the network is the `dt` of
            the files times this.
        steps: Next states per training sample.
        frame_range: First frame that a sample may start at, and the frame it must end before;
            null for the end of the simulation. The paper trains on 300 to 1500.
        sample_every: Frames between the starts of two samples.
        batch_size: Number of frames in a batch.
        split_by: `simulation` keeps the simulations of each file in one split. `frame` repeats
            the paper's split: samples of train.h5 and val.h5 are joined and divided at random,
            80 % for training, 20 % for both validation and test. Neighboring frames then lie on
            both sides, so the test leaks and its errors are too low.
        augmentation: Changes training samples, such as `BoxSymmetry`; none by default.
        rollout_steps: Steps of each rollout of `predict`; by default to the end of each
            simulation. It may be more than test.h5 has.
        rollout_simulations: Number of simulations that `predict` rolls out, from the first in
            test.h5; all by default.
        workers: Number of processes that read ahead.
        seed: Seed of the split by frame.

    Raises:
        UserError: an option is out of range; or, on use, a file is missing or unusable, or
            holds no sample.
    """

    def __init__(
        self,
        root: Path,
        voxel_size: float,
        stride: int = 1,
        steps: int = 1,
        frame_range: tuple[int, int | None] = (0, None),
        sample_every: int = 1,
        batch_size: int = 8,
        split_by: Literal["simulation", "frame"] = "simulation",
        augmentation: Augmentation | None = None,
        rollout_steps: int | None = None,
        rollout_simulations: int | None = None,
        workers: int = 0,
        seed: int = 0,
    ) -> None:
        super().__init__()
        self.root = Path(os.path.expandvars(root)).expanduser()
        self.voxel_size = voxel_size
        self.stride, self.steps = stride, steps
        self.frame_range, self.sample_every = frame_range, sample_every
        self.batch_size, self.split_by = batch_size, split_by
        self.augmentation, self.rollout_steps = augmentation, rollout_steps
        self.rollout_simulations = rollout_simulations
        self.workers, self.seed = workers, seed
        rollouts = ("rollout_steps", "rollout_simulations")
        counts = ("stride", "steps", "sample_every", "batch_size", *rollouts)
        for name, least in {"voxel_size": 1e-9, "workers": 0, **dict.fromkeys(counts, 1)}.items():
            value = getattr(self, name)
            if value is not None and not least <= value < math.inf:  # also refuses NaN
                raise UserError(f"data.{name} is {value}; it must be finite and at least {least}.")
        first, end = frame_range
        if first < 0 or (end is not None and end <= first):
            raise UserError(
                f"data.frame_range is {frame_range}; it must be a first frame of at least 0, and "
                "a later frame or null."
            )
        self._goes_on = True
        self._readers: dict[str, FrameReader] = {}
        self._samples: dict[str, list[Sample]] = {}

    # Settings of the model, read from the attributes of the files before `setup`.

    @cached_property
    def scene(self) -> Scene:
        """Scene of the first simulation, in the first file of the data set that exists."""
        for split in SPLITS:
            if (self.root / f"{split}.h5").exists():
                return self._reader(split).scenes(self.stride)[0]
        raise UserError(
            f"{self.root} holds none of train.h5, val.h5 and test.h5; "
            "make them with `fluidsnet generate`, or set data.root."
        )

    @property
    def scenes(self) -> Scene:
        """Scenes of all simulations in the files of the present stage, one after another."""
        readers = self._readers.values()
        return Scene.collate([scene for reader in readers for scene in reader.scenes(self.stride)])

    @property
    def time_step(self) -> float:
        """Time from a state to the next, s."""
        return self.scene.time_step

    @property
    def grid_shape(self) -> tuple[int, int, int]:
        """Cells of the background grid along x, y and z: the fewest that cover `scene`'s domain."""
        return grid_shape(self.scene, self.voxel_size)

    @property
    def dimension(self) -> int:
        """Number of dimensions of `scene`."""
        return self.scene.dimension

    @property
    def varying(self) -> list[str]:
        """Names of the `fluidsnet.scene.VALUES` that differ between the training simulations."""
        if not (self.root / "train.h5").exists():
            return []
        return varying(self._reader("train").scenes(self.stride))

    @cached_property
    def statistics(self) -> Statistics:
        """Normalization statistics of the training split."""
        return statistics(self._dataset("train", steps=1))

    def calibration_samples(self, count: int = 64) -> Iterator[Transitions]:
        """Yield samples of one step, evenly spread over the training split, without augmentation.

        Args:
            count: Greatest number of samples.
        """
        dataset = self._dataset("train", steps=1)
        every = -(-len(dataset) // count)
        return (dataset[index] for index in range(0, len(dataset), every))

    def identity(self, split: str) -> dict[str, Any]:
        """Return plain JSON values that identify the data of a split (`train`, `val`, `test`).

        Where `split_by` is `frame`, `file` and `sha256` list all files of the data set.
        """
        names = [split]
        if self.split_by == "frame":
            names = [name for name in SPLITS if (self.root / f"{name}.h5").exists()] or names
        readers = [self._reader(name) for name in names]
        return {
            "root": str(self.root),
            "file": ", ".join(reader.path.name for reader in readers),
            "sha256": ", ".join(reader.sha256 for reader in readers),
            "stride": self.stride,
            "time_step": self.stride * readers[0].header.dt,
            "frame_range": list(self.frame_range),
            "sample_every": self.sample_every,
            "simulations": sum(len(reader.frames) for reader in readers),
            "frames": sum(sum(reader.frames.values()) for reader in readers),
            **({"split_by": "frame", "seed": self.seed} if self.split_by == "frame" else {}),
        }

    # Hooks of Lightning.

    def setup(self, stage: str) -> None:
        splits = {"fit": ("train", "val"), "validate": ("val",)}.get(stage, ("test",))
        # Split by frame, the samples of each split come from these two files.
        dealt = self.split_by == "frame" and stage != "predict"
        for split in ("train", "val") if dealt else splits:
            self._reader(split).check_same_resolution(next(iter(self._readers.values())))
        if stage != "predict":
            for split in splits:
                self._samples_of(split)
        if stage == "fit" and self.augmentation is not None:
            self.augmentation.check(self.scenes)

    def state_dict(self) -> dict[str, Any]:
        return {"batch_size": self.batch_size, "processes": processes()}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        # Batches of another size would leave out other samples than those that are done.
        self._goes_on = state_dict == self.state_dict()

    def train_dataloader(self) -> DataLoader[Transitions]:
        dataset = self._dataset("train", self.steps)
        dataset.augmentation = self.augmentation
        epoch, batches = progress_of(self.trainer)
        if batches and not self._goes_on:
            rank_zero_warn(
                "data.batch_size or the number of processes is another than that of the "
                "checkpoint: the samples of its epoch are drawn anew."
            )
            batches = 0
        return self._load(dataset, TrainingOrder(dataset, epoch, batches * self.batch_size))

    def val_dataloader(self) -> DataLoader[Transitions]:
        return self._loader("val")

    def test_dataloader(self) -> DataLoader[Transitions]:
        return self._loader("test")

    def predict_dataloader(self) -> DataLoader[RolloutStart]:
        dataset = self.rollout_starts(
            "test", (0,), self.rollout_steps, self.rollout_simulations, beyond_truth=True
        )
        return DataLoader(dataset, batch_size=None, sampler=each_once(dataset))

    def rollout_starts(
        self,
        split: Literal["val", "test"],
        frames: Sequence[int | float] = (0,),
        steps: int | None = None,
        simulations: int | None = None,
        beyond_truth: bool = False,
    ) -> HDF5RolloutStarts:
        """Return rollout starts in val.h5 or test.h5, with their true states.

        It is that file also where `split_by` is `frame`: val.h5 is then not held out.

        The options are those of `HDF5RolloutStarts`.
        """
        return HDF5RolloutStarts(
            self._reader(split), self.stride, frames, steps, simulations, beyond_truth
        )

    def transfer_batch_to_device(
        self, batch: Any, device: torch.device, dataloader_idx: int
    ) -> Any:
        return batch.to(device, non_blocking=True)

    def teardown(self, stage: str) -> None:
        for reader in self._readers.values():
            reader.close()

    def _loader(self, split: str) -> DataLoader[Transitions]:
        dataset = self._dataset(split, self._steps(split))
        return self._load(dataset, each_once(dataset))

    def _load(self, dataset: TransitionDataset, order: Sampler[Any] | None) -> DataLoader[Any]:
        # Workers may be forked, and must not inherit an open file.
        for reader in self._readers.values():
            reader.close()
        return DataLoader(
            dataset,
            batch_size=self.batch_size,
            sampler=order,
            collate_fn=Transitions.collate,
            num_workers=self.workers,
            persistent_workers=self.workers > 0,
            pin_memory=torch.cuda.is_available(),
        )

    def _dataset(self, split: str, steps: int) -> TransitionDataset:
        return TransitionDataset(self._samples_of(split), self.stride, steps)

    def _reader(self, split: str) -> FrameReader:
        if split not in self._readers:
            self._readers[split] = FrameReader(self.root / f"{split}.h5")
        return self._readers[split]

    def _samples_of(self, split: str) -> list[Sample]:
        if split not in self._samples:
            names = ("train", "val") if self.split_by == "frame" else (split,)
            span = self.stride * self._steps(names[0])
            readers = [self._reader(name) for name in names]
            samples = samples_in(readers, span, self.frame_range, self.sample_every)
            if self.split_by == "frame":
                random.Random(self.seed).shuffle(samples)
                cut = round(0.8 * len(samples))
                train, held_out = samples[:cut], samples[cut:]
                self._samples = {"train": train, "val": held_out, "test": held_out}
            else:
                self._samples[split] = samples
        if not self._samples[split]:
            raise UserError(
                f"{self.root}: no sample for {split}: no simulation has "
                f"{self._steps(split) * self.stride + 1} frames (steps x data.stride + 1) "
                f"within data.frame_range {self.frame_range}; lower the stride or widen the range."
            )
        return self._samples[split]

    def _steps(self, split: str) -> int:
        """Return the next states per sample; validation and test always take one."""
        return self.steps if split == "train" else 1
