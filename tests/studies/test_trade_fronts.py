"""Pareto fronts of error and cost, and the sentences on them."""

from __future__ import annotations

import math

import pytest

from fluidsnet.studies.trade.fronts import compare, pareto, sentences
from fluidsnet.studies.trade.measure import Measured
from fluidsnet.studies.trade.rows import Row, floor, planes, useless

SOLVER = {"fine": (8.0, 1.0), "coarse": (2.0, 10.0), "bad": (9.0, 5.0), "broken": (1.0, math.inf)}


def row(label: str, kind: str, cpu: float, error: float, failed: bool = False) -> Row:
    measured = Measured(10, cpu, cpu, 0.0, 1.0, {"rollout_mm": {5: error}})
    return Row(label, kind, "", 1.0, {"a": measured}, {"b": "why"} if failed else {})


def test_a_front_has_what_no_other_beats_in_both() -> None:
    assert pareto(SOLVER) == ["coarse", "fine"]
    assert pareto({"a": (1.0, math.inf), "b": (math.nan, 1.0)}) == []
    # Of two of one cost the more accurate.
    assert pareto({"a": (1.0, 2.0), "b": (1.0, 1.0)}) == ["b"]


def test_points_are_compared_at_equal_error_and_at_equal_cost() -> None:
    found = compare({"quick": (1.0, 10.0), "good": (4.0, 2.0)}, SOLVER)
    # As little error as `coarse` for half the cost; as little as `fine` nowhere.
    assert found.faster == {"coarse": 2.0}
    # At the cost of `good` the solver has `coarse`; at that of `quick` nothing.
    assert found.closer == {"good": 5.0}
    assert found.on_front == ["quick", "good"]


def test_the_sentences() -> None:
    first, second = sentences(
        {"solver": SOLVER, "prior alone": {"p": (4.0, 2.0)}, "network": {"n": (5.0, 20.0)}}, "Here"
    )[:2]
    assert first.startswith("Here, 1 of 1 priors alone are beaten by no setting of the solver")
    assert "at equal cost the solver errs 5 times as much" in first
    assert "at equal error the solver costs 0.5 times as much (1 of 2 settings" in first
    assert second.startswith("Here, no network lies on the front")
    last = sentences({"prior alone": {"p": (4.0, 2.0)}, "network": {"n": (5.0, 20.0)}}, "Here")
    assert last == ["Here, no network beats the priors alone at its cost."]


def test_what_errs_as_much_as_a_trivial_predictor_is_left_out() -> None:
    rows = [
        row("constant", "trivial", 0.0, 10.0),
        row("floor", "floor", 9.0, 0.5),
        row("network", "network", 0.1, 12.0),
        row("prior", "prior alone", 1.0, 2.0),
        row("lost", "prior alone", 1.0, 1.0, failed=True),
    ]
    assert planes(rows, "rollout_mm", 5) == {"prior alone": {"prior": (1.0, 2.0)}}
    assert useless(rows, "rollout_mm", 5) == ["network", "lost"]
    assert floor(rows, "rollout_mm", 5) == 0.5 and math.isnan(floor(rows[:1], "rollout_mm", 5))
    assert rows[3].mean("rollout_mm", 5) == 2.0 and rows[4].mean("rollout_mm", 5) == math.inf
    assert math.isnan(rows[3].mean("rollout_mm", 6)) and rows[3].cpu == pytest.approx(1.0)
