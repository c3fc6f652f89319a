"""The scale of a data set: statistics of its training split."""

from __future__ import annotations

import math

import torch

from datamodules.transitions import TransitionDataset
from fluidsnet.statistics import Statistics

#: Statistics are taken from at most so many samples, evenly spread over the split.
STATISTICS_SAMPLES = 256


def statistics(dataset: TransitionDataset) -> Statistics:
    """Means and deviations over samples spread evenly over a data set.

    Args:
        dataset: transitions of the training split.
    """
    every = math.ceil(len(dataset) / STATISTICS_SAMPLES)
    counts = 0
    sums = torch.zeros(3, 3, dtype=torch.float64)
    squares = torch.zeros(3, 3, dtype=torch.float64)
    for index in range(0, len(dataset), every):
        sample = dataset[index]
        state = sample.state
        velocity = state.velocity.double()
        drift = sample.next_position[0].double() - state.position.double()
        rows = torch.stack(
            [
                velocity,
                sample.next_velocity[0].double() - velocity,
                drift - state.scene.time_step * velocity,
            ]
        )
        counts += len(state)
        sums += rows.sum(dim=1)
        squares += rows.square().sum(dim=1)
    means = sums / counts
    # One deviation for the three axes, so that no direction is stretched; never zero.
    deviations = (squares / counts - means.square()).mean(dim=1).clamp_min(1e-24).sqrt()
    means, deviations = means.float(), deviations.float()
    return Statistics(
        velocity_mean=means[0],
        velocity_deviation=deviations[0],
        change_mean=means[1],
        change_deviation=deviations[1],
        drift_deviation=deviations[2],
    )
