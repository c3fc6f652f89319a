"""Report of the ablation study: ``ablations.md``, with its CSV files and its figures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd
from jinja2 import Environment, StrictUndefined

from fluidsnet.studies.ablations import comparison, results, tables
from fluidsnet.studies.ablations.figures import draw_figures
from fluidsnet.studies.ablations.results import ONE_STEP, RUN, STARTS, Group, TrainedRun
from fluidsnet.whole_file import whole_file, write_whole


def write_report(output: Path, runs: Sequence[TrainedRun], planned: int) -> str:
    """Write ``ablations.md``, its CSV files and its figures; return the Markdown.

    Args:
        output: Folder of the files, made if missing.
        runs: The runs that are trained and tested.
        planned: Number of runs of the whole study.

    Raises:
        UserError: A folder is not the folder of a run.
    """
    output.mkdir(parents=True, exist_ok=True)
    groups = results.read_groups(runs)
    comparisons = comparison.compare(groups)
    if groups:
        _write_csv_files(output, groups, comparisons)
        for name, figure in draw_figures(groups).items():
            with whole_file(output / f"{name}.png") as partial:
                figure.savefig(partial)
    environment = Environment(
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    environment.globals |= {"comparison": comparison, "results": results, "tables": tables}
    template = Path(__file__).with_name("report.md.jinja").read_text("utf-8")
    text = environment.from_string(template).render(
        groups=groups, comparisons=comparisons, finished=len(runs), planned=planned
    )
    write_whole(output / "ablations.md", text)
    return text


def _write_csv_files(folder: Path, groups: Sequence[Group], comparisons: pd.DataFrame) -> None:
    """Write the tables with all digits and a row per seed."""
    rows = pd.concat([group.at_moments(name) for group in groups for name in (ONE_STEP, *STARTS)])
    keys = [*RUN, "table", "predictor", "steps", "time"]
    values = rows[rows["predictor"].isin(tables.ROWS)].set_index([*keys, "metric"])["value"]
    wide = values.unstack("metric", sort=False).reset_index()
    one_step, rollouts = wide[wide["table"] == ONE_STEP], wide[wide["table"] != ONE_STEP]
    one_step = one_step.reindex(columns=[*RUN, "predictor", *tables.ONE_STEP_METRICS])
    rollouts = rollouts.reindex(columns=[*keys, *tables.ROLLOUT_METRICS]).replace({"table": STARTS})
    rollouts = rollouts.rename(columns={"table": "start", "time": "time s", **tables.RENAMED})
    written = {
        "ablations": comparisons.drop(columns="step"),
        "ablations_one_step": one_step,
        "ablations_rollouts": rollouts,
    }
    for name, table in written.items():
        with whole_file(folder / f"{name}.csv") as partial:
            table.to_csv(partial, index=False)
