"""Tests of mixed precision, accumulated gradients, and the searches of a training step."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from outputs import output_of
from test_module import data, trainer
from torch import Tensor

from fluidsnet import FluidsNet
from fluidsnet.features import KernelMessages, NoGlobalFeature, VoxelField
from fluidsnet.integrator import Displacement
from fluidsnet.neighbors import BruteForce, Neighbors
from fluidsnet.particles import Particles
from fluidsnet.priors import FreeFall
from fluidsnet.target import DisplacementTarget, VelocityTarget

Make = Callable[..., Particles]


class Watched(FluidsNet):
    """FluidsNet that keeps the losses of all steps."""

    def on_train_start(self) -> None:
        self.losses: list[float] = []

    def on_train_batch_end(self, outputs: Any, batch: Any, batch_idx: int) -> None:
        self.losses.append(float(self.trainer.callback_metrics["train/loss"]))


BLOCKS: dict[str, Callable[[], dict[str, Any]]] = {
    "paper": lambda: {},
    "field": lambda: {
        "local": KernelMessages(),
        "global_feature": VoxelField,
        "target": DisplacementTarget(),
        "integrator": Displacement(),
    },
}


# On the CPU, Lightning takes bfloat16 in place of half.
@pytest.mark.parametrize(
    ("blocks", "precision"),
    [("paper", "bf16-mixed"), ("paper", "16-mixed"), ("field", "bf16-mixed")],
)
@pytest.mark.filterwarnings("ignore:.*fp16 is not supported on CPU.*")
def test_mixed_precision_learns(blocks: str, precision: str, sample: Path, tmp_path: Path) -> None:
    torch.manual_seed(0)
    # Two steps, so that gradients go through positions and velocities too.
    source = data(sample, steps=2, batch_size=2)
    model = Watched(source.grid_shape, **BLOCKS[blocks]())
    runner = trainer(tmp_path, max_epochs=24, overfit_batches=1, precision=precision)
    runner.fit(model, source)
    losses = torch.tensor(model.losses)
    assert losses.isfinite().all()
    assert losses[-6:].mean() < 0.9 * losses[:6].mean()
    assert all(weight.dtype == torch.float32 for weight in model.parameters())
    assert torch.isfinite(runner.callback_metrics["val/skill"])


@pytest.mark.parametrize("blocks", BLOCKS)
def test_mixed_precision_is_near_full_precision_and_gives_full_precision(
    blocks: str, make_particles: Make, device: torch.device
) -> None:
    torch.manual_seed(0)
    model = FluidsNet((6, 4, 6), **BLOCKS[blocks]()).to(device).model.network.eval()
    particles = make_particles((300, 100), (200, 50))
    expected = output_of(model, particles)
    expected.square().mean().backward()
    gradients = [weight.grad.clone() for weight in model.parameters() if weight.grad is not None]
    model.zero_grad()
    with torch.autocast(device.type, torch.bfloat16):
        found = output_of(model, particles)
        features = model.local(particles, model.neighbors(particles), model.inputs, torch.empty(0))
    found.square().mean().backward()
    assert found.dtype == features.dtype == torch.float32
    assert (found - expected).norm() < 0.02 * expected.norm()
    for weight, gradient in zip(model.parameters(), gradients, strict=True):
        assert weight.grad is not None
        assert (weight.grad - gradient).norm() < 0.05 * gradient.norm() + 1e-6


def test_a_small_move_far_out_is_seen_in_mixed_precision(
    make_particles: Make, device: torch.device
) -> None:
    # A thousandth of the domain, which bfloat16 loses near its far end.
    model = FluidsNet((6, 4, 6), global_feature=NoGlobalFeature).to(device).model.network
    particles = make_particles((300, 100))
    moved = particles.moved(particles.position * 0.999, particles.velocity)
    with torch.autocast(device.type, torch.bfloat16):
        places = [model.inputs(state, FreeFall()(state)) for state in (particles, moved)]
        first = [model.head[0](torch.cat([p, p.new_zeros(len(p), 9)], dim=1)) for p in places]
    assert first[0].dtype == torch.float32
    assert ((first[0] - first[1]).abs().sum(dim=1) > 0).all()


def weights_after(model: FluidsNet, source: Any, folder: Path, **changes: Any) -> list[Tensor]:
    source.train_dataloader = lambda: source._loader("train")  # in order
    trainer(folder, limit_val_batches=0, **changes).fit(model, source)
    return [weight.detach().clone() for weight in model.parameters()]


def test_two_accumulated_batches_are_one_of_twice_the_size(sample: Path, tmp_path: Path) -> None:
    # Without batch norm, whose statistics are a batch's own, and with as many particles in each
    # batch (three frames of one simulation), as the mean of means weighs batches alike.
    weights = []
    for size, accumulated in ((3, 2), (6, 1)):
        torch.manual_seed(0)
        source = data(sample, sample_every=7, batch_size=size)
        model = FluidsNet(source.grid_shape, global_feature=VoxelField, target=VelocityTarget())
        weights.append(
            weights_after(model, source, tmp_path, max_steps=3, accumulate_grad_batches=accumulated)
        )
    for found, expected in zip(*weights, strict=True):
        assert torch.allclose(found, expected, rtol=1e-4, atol=1e-5)


class Counting(BruteForce):
    """Neighbor search that counts its calls."""

    calls = 0

    def __call__(self, particles: Particles) -> Neighbors:
        self.calls += 1
        return super().__call__(particles)


def test_a_batch_is_searched_once_however_many_rounds_and_frames(sample: Path) -> None:
    source = data(sample, batch_size=3)
    search = Counting()
    model = FluidsNet(source.grid_shape, neighbors=search, local=KernelMessages(rounds=3))
    model.log = lambda *_, **__: None  # type: ignore[method-assign]
    batch = next(iter(source.train_dataloader()))
    model.training_step(batch, 0).backward()
    assert search.calls == 1
