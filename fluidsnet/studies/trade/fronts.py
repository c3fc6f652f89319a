"""Pareto fronts of error and cost, and the comparison of two kinds of points."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import final

#: Cost and error of a point by its label.
Plane = Mapping[str, tuple[float, float]]


@final
@dataclass(frozen=True)
class Comparison:
    """Points of one kind against the front of a rival.

    Attributes:
        faster: For each point of the rival's front whose error is reached, the rival's cost over
            that of the cheapest point that errs no more; by the rival's label.
        closer: For each point of the own front that the rival can afford, the rival's least error
            at no more cost over the own; by the own label.
        on_front: Labels of own points that lie on the front of both together.
    """

    faster: dict[str, float]
    closer: dict[str, float]
    on_front: list[str]


def pareto(plane: Plane) -> list[str]:
    """Return the labels of points that no other beats in cost and error, in order of cost.

    A point whose cost or error is not finite is on no front.
    """
    front: list[str] = []
    least = math.inf
    for label, (cost, error) in sorted(plane.items(), key=lambda item: item[1]):
        if math.isfinite(cost) and error < least:
            front.append(label)
            least = error
    return front


def compare(own: Plane, rival: Plane) -> Comparison:
    """Compare points with those of a rival, at equal error and at equal cost."""
    faster, closer = {}, {}
    for label in pareto(rival):
        cost, error = rival[label]
        enough = [it[0] for it in own.values() if it[1] <= error]
        if enough:
            faster[label] = cost / max(min(enough), 1e-12)
    for label in pareto(own):
        cost, error = own[label]
        affordable = [it[1] for it in rival.values() if it[0] <= cost and math.isfinite(it[1])]
        if affordable:
            closer[label] = min(affordable) / max(error, 1e-12)
    both = pareto({**rival, **own})
    return Comparison(faster, closer, [label for label in both if label in own])


def sentences(planes: Mapping[str, Plane], when: str) -> list[str]:
    """Return what speed costs: each kind of models against the solver, in words.

    Args:
        planes: Points of the kinds "solver", "prior alone" and "network".
        when: Where the error was measured, such as "1 s into a rollout".
    """
    solver, told = planes.get("solver", {}), []
    for kind, name in (("prior alone", "priors alone"), ("network", "networks")):
        own = planes.get(kind, {})
        if not own or not any(map(_is_finite, solver.values())):
            continue
        found, front = compare(own, solver), len(pareto(solver))
        if not found.on_front:
            told.append(
                f"{when}, no {kind} lies on the front: for each there is a setting of the solver "
                "that costs no more and errs no more."
            )
            continue
        parts = []
        if found.faster:
            reached = len(found.faster)
            rest = f" ({front - reached} of {front} settings on the solver's front err less still)"
            parts.append(
                f"at equal error the solver costs {_range(found.faster.values(), 'times as much')}"
                + (rest if reached < front else "")
            )
        else:
            parts.append("none errs as little as a setting on the solver's front")
        if found.closer:
            parts.append(
                f"at equal cost the solver errs {_range(found.closer.values(), 'times as much')}"
            )
        cheaper = [label for label in pareto(own) if label not in found.closer]
        if cheaper:
            parts.append(f"{len(cheaper)} of them cost less than any setting of the solver")
        told.append(
            f"{when}, {len(found.on_front)} of {len(own)} {name} are beaten by no setting of the "
            f"solver: {'; '.join(parts)}."
        )
    networks, priors = planes.get("network", {}), planes.get("prior alone", {})
    if networks and priors:
        better = compare(networks, priors).on_front
        told.append(
            f"{when}, {', '.join(better)} beat the priors alone at their cost."
            if better
            else f"{when}, no network beats the priors alone at its cost."
        )
    return told


def _is_finite(point: tuple[float, float]) -> bool:
    return all(map(math.isfinite, point))


def _range(values: Iterable[float], unit: str) -> str:
    numbers = sorted(values)
    low, high = f"{numbers[0]:.2g}", f"{numbers[-1]:.2g}"
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"
