"""``fluidsnet trade recommend``: the point of a finished study that serves a need best."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path

from fluidsnet.errors import UserError
from fluidsnet.studies.parser import parse_options
from fluidsnet.studies.trade.measure import Measured
from fluidsnet.studies.trade.report import ROWS
from fluidsnet.studies.trade.rows import Row, floor


@dataclass(frozen=True)
class RecommendOptions:
    """Options of ``fluidsnet trade recommend``; give one limit or both.

    Attributes:
        study: Folder of a finished study.
        max_error: Greatest mean distance from the truth along a rollout, mm; the cheapest point
            that keeps it is named.
        max_seconds: Most CPU seconds for a second of fluid; the most accurate point that keeps
            them is named.
        after: Time along the rollout at which the error counts, s; the nearest mark of the study
            is taken.
    """

    study: str = "runs/trade"
    max_error: float | None = None
    max_seconds: float | None = None
    after: float = 0.5

    def __post_init__(self) -> None:
        if self.max_error is None and self.max_seconds is None:
            raise UserError("Give --max_error in mm, --max_seconds, or both.")
        for name in ("max_error", "max_seconds", "after"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise UserError(f"--{name} is {value}; set it above zero.")


def recommend_command(arguments: list[str]) -> None:
    """Print the recommendation.

    Raises:
        UserError: There is no finished study, or none of its points keeps the limits.
    """
    options = parse_options(
        "trade recommend",
        "Name the model, the prior or the solver setting of a finished study that keeps a limit "
        "of error or time at the least cost or error.",
        RecommendOptions,
        arguments,
    )
    rows, marks = read_rows(Path(options.study))
    print(recommend(options, rows, marks))


def recommend(options: RecommendOptions, rows: list[Row], marks: list[int]) -> str:
    """Return the recommendation in words.

    Raises:
        UserError: No point keeps the limits.
    """
    interval = rows[0].interval
    mark = min(marks, key=lambda frames: abs(frames * interval - options.after))
    after = f"after {mark * interval:g} s of a rollout"
    points = [
        (row.cpu, error, row)
        for row in rows
        if row.kind not in ("trivial", "floor")
        and math.isfinite(error := row.mean("rollout_mm", mark))
    ]
    if not points:
        raise UserError(f"{options.study} has no point with an error {after}.")
    most_error = math.inf if options.max_error is None else options.max_error
    most_cost = math.inf if options.max_seconds is None else options.max_seconds
    kept = [it for it in points if it[1] <= most_error and it[0] <= most_cost]
    if not kept:
        least, cheapest = min(it[1] for it in points), min(it[0] for it in points)
        raise UserError(
            f"No point of {options.study} keeps that: {after} the least error is {least:.3g} mm, "
            f"and the least cost {cheapest:.3g} CPU s for a second of fluid."
        )
    # With a limit of error the cost decides, else the error.
    by = (0, 1) if options.max_error is not None else (1, 0)
    cost, error, row = min(kept, key=lambda it: (it[by[0]], it[by[1]]))
    lines = [
        f"{row.label} ({row.kind}): {error:.3g} mm {after}, {cost:.3g} CPU s and {row.wall:.3g} s "
        "for a second of fluid.",
        row.advice,
    ]
    others = [it for it in kept if (it[2].kind == "solver") != (row.kind == "solver")]
    if others:
        rival = min(others, key=lambda it: (it[by[0]], it[by[1]]))
        lines.append(
            f"The next best of the other side, {rival[2].label} ({rival[2].kind}): "
            f"{rival[1]:.3g} mm, {rival[0]:.3g} CPU s."
        )
    elif row.kind != "solver" and any(it[2].kind == "solver" for it in points):
        lines.append("No setting of the solver that was measured keeps the limit.")
    chaos = floor(rows, "rollout_mm", mark)
    if error < 1.5 * chaos:
        lines.append(
            f"The floor of chaos is {chaos:.3g} mm there: errors near it mean nothing; take an "
            "earlier time with --after."
        )
    return "\n".join(lines)


def read_rows(study: Path) -> tuple[list[Row], list[int]]:
    """Read the rows and marks of a finished study.

    Raises:
        UserError: The folder holds none.
    """
    path = study / ROWS
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
        rows = [
            Row(**{**row, "measured": {k: measured_from(v) for k, v in row["measured"].items()}})
            for row in stored["rows"]
        ]
        marks: list[int] = stored["marks"]
    except FileNotFoundError as error:
        raise UserError(
            f"{path} is missing: run `fluidsnet trade` first, or name its folder with --study."
        ) from error
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UserError(f"{path} is damaged; run `fluidsnet trade` again.") from error
    if not rows:
        raise UserError(f"{path} has no point.")
    return rows, marks


def measured_from(values: dict[str, object]) -> Measured:
    """Return results that were stored as JSON, whose keys are text."""
    measured = Measured(**values)  # type: ignore[arg-type]
    for result, by_frames in measured.values.items():
        measured.values[result] = {int(frames): value for frames, value in by_frames.items()}
    return measured
