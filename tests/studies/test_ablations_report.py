"""The ablation study's report, compared with numbers read directly from its runs' files."""

from __future__ import annotations

import csv
import math
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import fmean, stdev

import lightning
import numpy as np
import pandas as pd
import pytest
from PIL import Image
from scipy.stats import ttest_1samp

from fluidsnet.errors import UserError
from fluidsnet.main import main
from fluidsnet.reporting.results import results_folders
from fluidsnet.studies.ablations.comparison import Ratio, digits
from fluidsnet.studies.ablations.figures import energy_figure, target_figure, trivial_mse
from fluidsnet.studies.ablations.report import energy_verdict, write_report
from fluidsnet.studies.ablations.results import TrainedRun, read_groups
from fluidsnet.studies.ablations.tables import (
    describe_change,
    final_change,
    spread,
    worst_change,
)

ROOT = Path(__file__).parents[2]
MSE = "velocity_mse m²/s²"
INF, NAN = math.inf, math.nan
IN_PART = "confirmed in part: it has less energy than the truth, but is not near 0"
MORE = "refuted: it has more energy than the truth"

# Lightning logs to the stderr of its first import, which must not be a test's captured one.
assert lightning

Table = list[dict[str, str]]
Copy = Callable[..., list[TrainedRun]]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[TrainedRun]:
    """Real trainings with both twins: two seeds at one stride, one at another."""
    folder = tmp_path_factory.mktemp("ablations")
    names = (
        "trainer", "model/paper", "data/sample", "study/ablations", "ablation/target",
        "ablation/global_feature",
    )  # fmt: skip
    found = []
    for stride, seed in ((1, 0), (1, 1), (2, 0)):
        name = f"dam/stride_{stride}/seed_{seed}"
        main(
            [
                "fit",
                *(f"--config={ROOT / 'configs' / config}.yaml" for config in names),
                f"--data.init_args.root={ROOT / 'tests' / 'data' / 'dam_break'}",
                "--data.init_args.batch_size=2",
                "--data.init_args.sample_every=1",
                f"--data.init_args.stride={stride}",
                f"--seed_everything={seed}",
                "--trainer.max_steps=8",
                "--trainer.limit_val_batches=2",
                "--trainer.limit_test_batches=4",
                "--trainer.val_check_interval=1",
                "--trainer.log_every_n_steps=1",
                "--trainer.enable_progress_bar=false",
                f"--trainer.logger.init_args.save_dir={folder}",
                f"--trainer.logger.init_args.name={name}",
                "--trainer.logger.init_args.version=",
            ]
        )
        main(["test", f"--run={folder / name}"])
        found.append(TrainedRun("dam", stride, seed, folder / name))
    return found


@pytest.fixture
def copy(runs: Sequence[TrainedRun], tmp_path: Path) -> Copy:
    """Make copies of the first run that a test may change, one for each seed."""

    def make(count: int) -> list[TrainedRun]:
        made = []
        for seed in range(count):
            folder = tmp_path / "copies" / f"seed_{seed}"
            shutil.copytree(runs[0].folder, folder)
            made.append(TrainedRun("dam", 1, seed, folder))
        return made

    return make


def table(path: Path) -> Table:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def number(path: Path, column: str, **where: str) -> float:
    (row,) = (row for row in table(path) if where.items() <= row.items())
    return float(row[column])


def results(run: TrainedRun) -> Path:
    (folder,) = results_folders(run.folder)
    return folder


def one_step(run: TrainedRun, predictor: str, column: str) -> float:
    return number(results(run) / "one_step.csv", column, **{"one step ahead": predictor})


def rolled(run: TrainedRun, predictor: str, steps: int, column: str, start: str = "") -> float:
    where = {"predictor": predictor, "steps": str(steps)}
    return number(results(run) / f"rollout_metrics{start}.csv", column, **where)


def change(path: Path, column: str, value: float, **where: str) -> None:
    """Change a number in a run's table."""
    rows = table(path)
    chosen = [row for row in rows if where.items() <= row.items()]
    assert chosen
    for row in chosen:
        row[column] = repr(value)
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def change_one_step(run: TrainedRun, predictor: str, column: str, value: float) -> None:
    change(results(run) / "one_step.csv", column, value, **{"one step ahead": predictor})


def row(text: str, *begin: str) -> list[str]:
    """Return the cells of the report's first table row that begins with some cells."""
    found = ([cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines())
    return next(cells for cells in found if cells[: len(begin)] == list(begin))


def test_one_step_is_mean_and_deviation_over_seeds(runs: list[TrainedRun], tmp_path: Path) -> None:
    text = write_report(tmp_path, runs, 3)
    assert text == (tmp_path / "ablations.md").read_text()
    assert "runs are finished" not in text
    first, second = (
        text.index("### dam, 20 ms a step (stride 1), 2 seeds"),
        text.index("### dam, 40 ms a step (stride 2), 1 seed\n"),
    )
    cells = row(text[first:], "without global feature")
    values = [one_step(run, "no global feature", "skill") for run in runs[:2]]
    mean, deviation = (float(part) for part in cells[1].split(" ± "))
    assert deviation == pytest.approx(stdev(values), rel=0.06)
    assert mean == pytest.approx(fmean(values), abs=stdev(values) / 10)
    trivial = one_step(runs[0], "ballistic", MSE)
    assert row(text[first:], "ballistic")[2] == f"{trivial:.4g}"
    alone = one_step(runs[2], "model", "position_error_1 mm")
    assert row(text[second:], "model (velocity, global feature)")[3] == f"{alone:.4g}"
    written = table(tmp_path / "ablations_one_step.csv")
    assert len(written) == 3 * 5
    for name in ("no global feature", "ballistic"):
        place = {"scene": "dam", "stride": "1", "seed": "1", "predictor": name}
        (line,) = (line for line in written if place.items() <= line.items())
        for column in ("skill", MSE, "position_error_1 mm"):
            assert float(line[column]) == one_step(runs[1], name, column)


def test_twins_are_paired_by_seed_and_two_seeds_decide_nothing(
    runs: list[TrainedRun], tmp_path: Path
) -> None:
    text = write_report(tmp_path, list(reversed(runs)), 3)
    found = {
        (line["twin"], line["stride"], line["figure"]): line
        for line in table(tmp_path / "ablations.csv")
    }
    assert len(found) == 2 * 2 * 3
    for predictor in ("acceleration", "no global feature"):
        for figure, column in (("position_error, 0.8 s", "position_error mm"),
                               ("chamfer, 0.8 s", "chamfer mm")):  # fmt: skip
            each = [
                rolled(run, predictor, 40, column) / rolled(run, "model", 40, column)
                for run in runs[:2]
            ]
            line = found[predictor, "1", figure]
            assert [float(value) for value in line["each seed"].split()] == pytest.approx(each)
            assert float(line["twin / model"]) == pytest.approx(math.sqrt(each[0] * each[1]))
        each = [one_step(run, predictor, MSE) / one_step(run, "model", MSE) for run in runs]
        for stride, ratio in (("1", math.sqrt(each[0] * each[1])), ("2", each[2])):
            line = found[predictor, stride, "velocity_mse, one step"]
            assert float(line["twin / model"]) == pytest.approx(ratio)
            assert (line["from"], line["to"], line["decided"]) == ("", "", "not decided")
            assert line["seeds"] == ("2" if stride == "1" else "1")
            if predictor == "acceleration":
                step, seeds = ("20", "2 seeds") if stride == "1" else ("40", "1 seed")
                assert (
                    f"- At {step} ms a step (dam, {seeds}): not decided: velocity_mse with the "
                    f"acceleration target is {digits(ratio)} times that with the velocity target."
                ) in text


def test_rollouts_are_reported_at_the_same_times(runs: list[TrainedRun], tmp_path: Path) -> None:
    text = write_report(tmp_path, runs, 3)
    part = text[text.index("## Rollouts from rest") : text.index("## Rollouts in motion")]
    assert "the times of the" not in text
    truth = rolled(runs[2], "truth", 5, "kinetic_energy J/kg")
    # 0.2 s are five steps of 40 ms.
    stride_2 = part[part.index("stride 2") :]
    cells = row(stride_2, "0.2", "5", "without global feature")
    assert cells[3] == f"{rolled(runs[2], 'no global feature', 5, 'position_error mm'):.4g}"
    assert cells[4] == "–"
    energy = rolled(runs[2], "no global feature", 5, "kinetic_energy J/kg")
    assert cells[5:7] == [f"{energy:.4g}", f"{truth:.4g}"]
    assert row(stride_2, "0.8", "20", "truth")[5] == row(stride_2, "0.8", "20", "ballistic")[6]
    written = table(tmp_path / "ablations_rollouts.csv")
    assert {(line["start"], line["stride"], line["steps"]) for line in written} == {
        ("from rest", "1", "10"), ("from rest", "1", "40"),
        ("from rest", "2", "5"), ("from rest", "2", "20"),
        ("in motion", "1", "10"), ("in motion", "1", "30"),
        ("in motion", "2", "5"), ("in motion", "2", "15"),
    }  # fmt: skip
    assert len(written) == 3 * 2 * 2 * 7
    moving = text[text.index("## Rollouts in motion") :]
    cells = row(moving[moving.index("stride 2") :], "0.6", "15", "acceleration target")
    error = rolled(runs[2], "acceleration", 15, "position_error mm", "_in_motion")
    assert cells[3] == f"{error:.4g}"


def test_three_seeds_decide(copy: Copy, tmp_path: Path) -> None:
    made = copy(3)
    ratios = (0.010, 0.012, 0.015)
    for run, ratio in zip(made, ratios, strict=True):
        change_one_step(run, "acceleration", MSE, ratio * one_step(run, "model", MSE))
    for run, ratio in zip(made, (0.5, 2.0, 4.0), strict=True):
        change_one_step(run, "no global feature", MSE, ratio * one_step(run, "model", MSE))
    text = write_report(tmp_path, made, 3)
    logs = np.log(ratios)
    # The 97.5 % quantile of Student's t with two degrees of freedom.
    half = 4.302652729911275 * logs.std(ddof=1) / math.sqrt(3)
    mean, lower, upper = (math.exp(logs.mean() + sign * half) for sign in (0, -1, 1))
    assert (
        "- At 20 ms a step (dam, 3 seeds): refuted: velocity_mse with the acceleration target is "
        f"{mean:#.3g} [{lower:#.3g}, {upper:#.3g}] times that with the velocity target."
    ) in text
    assert "(dam, 3 seeds): not decided: velocity_mse without the global feature is 1.59 " in text
    line = table(tmp_path / "ablations.csv")[0]
    assert float(line["from"]) == pytest.approx(lower) and line["decided"] == "the twin is better"


@pytest.mark.parametrize("each", [(1.1, 1.3, 1.2), (0.4, 3.0, 1.0, 2.0), (1e-3, 2e-3, 1e-3)])
def test_the_interval_is_that_of_scipys_t_test(each: tuple[float, ...]) -> None:
    ratio = Ratio(each)
    known = ttest_1samp(np.log(each), 0.0).confidence_interval(0.95)
    assert ratio.interval == pytest.approx((math.exp(known.low), math.exp(known.high)))
    assert ratio.mean == pytest.approx(np.prod(each) ** (1 / len(each)))
    decided = known.low > 0 or known.high < 0
    assert ratio.side() == (decided and (1 if ratio.mean > 1 else -1))


@pytest.mark.parametrize(
    ("each", "mean", "text"),
    [
        ((), NAN, "unknown"),
        ((4.0,), 4.0, "4.00"),
        ((1.0, 4.0), 2.0, "2.00"),
        ((2.0, INF, 2.0), INF, "inf (not finite in 1 of 3 seeds)"),
        ((2.0, NAN, INF), NAN, "nan (not finite in 2 of 3 seeds)"),
        ((2.0, 0.0, 2.0), 0.0, "0.00"),
        ((1e300, 1e-300, 1e300, 1e-300), 1.0, "1.00 [0.00, inf]"),
    ],
)
def test_ratios_without_an_interval(each: tuple[float, ...], mean: float, text: str) -> None:
    ratio = Ratio(each)
    assert ratio.mean == pytest.approx(mean, nan_ok=True)
    assert str(ratio) == text and ratio.side() == 0


@pytest.mark.parametrize(
    ("value", "text"), [(0.0996, "0.0996"), (0.99996, "1.00"), (999.4, "999"), (999.7, "1,000")]
)
def test_three_digits_and_no_exponent(value: float, text: str) -> None:
    assert digits(value) == text


def test_ratios_of_values_that_are_not_finite() -> None:
    pairs = [(1.0, 2.0), (INF, 2.0), (INF, INF), (1.0, INF), (1.0, 0.0), (0.0, 0.0), (0.0, 1.0)]
    expected = (0.5, INF, NAN, 0.0, INF, NAN, 0.0)
    assert Ratio.of(pairs).each == pytest.approx(expected, nan_ok=True)


def around(value: float) -> Ratio:
    """Return a ratio with a narrow interval around a value."""
    return Ratio((0.99 * value, value, 1.01 * value))


@pytest.mark.parametrize(
    ("share", "relative", "verdict"),
    [
        (around(0.05), around(0.5), "confirmed"),
        (around(0.9), around(0.95), IN_PART),
        (around(0.1), around(0.5), IN_PART),
        (around(1.0), around(0.5), "not decided"),
        (around(0.9), Ratio((0.05, 0.9, 0.6)), "not decided"),
        (Ratio((0.05, 0.9, 0.6)), around(0.9), "not decided"),
        (around(1.2), around(0.5), MORE),
        (around(1.2), Ratio((0.3, 0.9, 1.5)), MORE),
        (around(0.02), around(2.0), "refuted: with the global feature there is even less energy"),
        (around(0.02), around(1.0), "not decided"),
        (Ratio((0.01, 0.01)), Ratio((0.1, 0.1)), "not decided"),
        (Ratio((1.0, 1.1, INF)), Ratio((1.0, 1.1, INF)), "not decided"),
    ],
)
def test_energy_verdict(share: Ratio, relative: Ratio, verdict: str) -> None:
    assert energy_verdict(share, relative) == verdict


def test_energies_at_both_times(runs: list[TrainedRun], tmp_path: Path) -> None:
    text = write_report(tmp_path, runs, 3)
    for time, steps in (("0.2", 5), ("0.6", 15)):
        without, with_it, truth = (
            rolled(runs[2], predictor, steps, "kinetic_energy J/kg", "_in_motion")
            for predictor in ("no global feature", "model", "truth")
        )
        assert (
            f"- At 40 ms a step (dam, 1 seed), after {time} s: not decided: a rollout without the "
            f"global feature has {digits(without / truth)} times the truth's kinetic energy, one "
            f"with it {digits(with_it / truth)} times; the ratio of the two is "
            f"{digits(without / with_it)}."
        ) in text


def test_negative_skill_of_all_models_is_reported(copy: Copy, tmp_path: Path) -> None:
    made = copy(2)
    for run in made:
        for predictor in ("model", "acceleration", "no global feature"):
            change_one_step(run, predictor, "skill", -0.5)
    warning = "**dam, 20 ms a step: the skill of all models is below 0"
    pair = "The skill of both is below 0, worse than the trivial predictors."
    text = write_report(tmp_path, made, 2)
    assert warning in text and text.count(pair) == 2
    # The mean over the seeds counts.
    change_one_step(made[0], "acceleration", "skill", 0.4)
    assert warning in write_report(tmp_path, made, 2)
    change_one_step(made[0], "acceleration", "skill", 0.6)
    text = write_report(tmp_path, made, 2)
    assert warning not in text and text.count(pair) == 1


@pytest.mark.parametrize(
    ("values", "steps", "description"),
    [
        ([9, 9, 9, 9, 9, 9, 8, 6], 8, "falls 25 %"),
        ([9, 9, 9, 9, 9, 9, 8, 10], 8, "rises 25 %"),
        ([9, 9, 9, 9, 9, 9, 1, 0.96], 8, "flat"),
        ([9, 9, 9, 9, 9, 9, 1, 0.94], 8, "falls 6 %"),
        # Means over two each.
        ([9] * 12 + [3, 5, 2, 1], 16, "falls 62 %"),
        ([9, 8, 7, 6], 4, "too few validations"),
        # The last eighth has no validation.
        ([9, 8, 7, 6, 5, 4, 3, 2], 10, "too few validations"),
        ([], 8, "too few validations"),
        ([9, 9, 9, 9, 9, 9, INF, 6], 8, "not finite"),
        ([9, 9, 9, 9, 9, 9, 8, NAN], 8, "not finite"),
    ],
)
def test_final_change(values: list[float], steps: int, description: str) -> None:
    every = steps // len(values) if values else 1
    index = [every * (count + 1) - 1 for count in range(len(values))]
    assert describe_change(final_change(pd.Series(values, index, float), steps)) == description


def test_the_worst_of_the_seeds() -> None:
    few, not_finite, flat, falls, rises = INF, NAN, 0.01, -0.2, 0.1
    assert worst_change([flat, rises, falls]) is falls
    assert worst_change([falls, not_finite]) is not_finite
    assert worst_change([not_finite, few, falls]) is few


def test_length_of_training(runs: list[TrainedRun], tmp_path: Path) -> None:
    part = write_report(tmp_path, runs, 3).partition("## Was training long enough?")[2]
    cells = row(part, "dam", "20 ms a step")
    # The schedule of `paper.yaml` multiplies the rate by 0.05 halfway.
    assert cells[2:5] == ["8", "0.003 to 0.00015", "8"]
    ends = []
    for run in read_groups(runs)[0].runs:
        *_, before, last = run.curve("velocity_mse", "model")
        ends.append(last / before - 1)
    assert cells[5] == describe_change(max(ends, key=abs))


@pytest.mark.parametrize(
    ("values", "seeds", "text"),
    [
        ([], 3, "–"),
        ([0.5], 1, "0.5"),
        ([0.5], 2, "0.5 (1 of 2 seeds)"),
        ([0.5, 0.5], 2, "0.5"),
        ([1.0, 2.0, 3.0], 3, "2.0 ± 1.0"),
        ([1.0, 1.001], 2, "1.00050 ± 0.00071"),
        ([500.0, 1100.0], 2, "800 ± 420"),
        ([1e-9, 3e-9], 2, "2e-09 ± 1.4e-09"),
        ([1.0, 2.0], 3, "1.50 ± 0.71 (2 of 3 seeds)"),
        ([1.0, INF, 2.0], 3, "inf in 1 of 3 seeds"),
        ([1.0, NAN], 3, "nan in 1 of 2 seeds (2 of 3 seeds)"),
        ([-INF, -1.0], 2, "-inf in 1 of 2 seeds"),
        ([INF], 1, "inf"),
    ],
)
def test_spread(values: list[float], seeds: int, text: str) -> None:
    assert spread(values, seeds) == text


def test_a_rollout_that_blew_up_is_infinite(copy: Copy, tmp_path: Path) -> None:
    made = copy(2)
    path = results(made[1]) / "rollout_metrics.csv"
    change(path, "position_error mm", INF, predictor="no global feature", steps="40")
    path = results(made[1]) / "rollout_metrics_in_motion.csv"
    change(path, "kinetic_energy J/kg", INF, predictor="no global feature", steps="30")
    text = write_report(tmp_path, made, 2)
    rollouts = text[text.index("## Rollouts from rest") :]
    assert row(rollouts, "0.8", "40", "without global feature")[3] == "inf in 1 of 2 seeds"
    found = row(text, "without global feature", "dam", "20 ms a step", "position_error, 0.8 s")
    assert found[5] == "inf" and found[8].endswith(", inf") and found[9] == "not decided"
    assert "the ratio of the two is inf (not finite in 1 of 2 seeds)." in text
    (axes,) = energy_figure(read_groups(made)).axes
    assert "without global feature: not finite in the end" in axes.get_title()
    change(path, "kinetic_energy J/kg", 1e6, predictor="no global feature", steps="30")
    (axes,) = energy_figure(read_groups(made)).axes
    assert "without global feature: up to 1e+06 J/kg" in axes.get_title()
    truth = max(
        rolled(made[0], "truth", steps, "kinetic_energy J/kg", "_in_motion")
        for steps in (1, 2, 5, 10, 25, 30)
    )
    assert axes.get_ylim() == pytest.approx((0, 1.08 * 3 * truth))


def test_missing_files_are_reported(copy: Copy, tmp_path: Path) -> None:
    made = copy(2)
    path = "global_feature_permutation.csv"
    ratio = number(
        results(made[0]) / path, "velocity_mse / own", **{"global feature of": "another frame"}
    )
    (results(made[1]) / path).unlink()
    text = write_report(tmp_path, made, 7)
    assert "**2 of 7 runs are finished.**" in text
    assert "dam, stride 1, seed 1: there is no global_feature_permutation.csv.\n" in text
    assert "seed 0: there" not in text
    part = text[text.index("## Does the network use") :]
    assert row(part, "dam")[2:] == ["1", f"{ratio:.4g} (1 of 2 seeds)"]
    for folder in [results(run) for run in made]:
        for name in (path, "rollout_metrics.csv", "rollout_metrics_in_motion.csv", "one_step.csv"):
            (folder / name).unlink(missing_ok=True)
    text = write_report(tmp_path, made, 2)
    part = text[text.index("## Does the network use") :]
    assert row(part, "dam")[1:] == ["stride 1", "0", "–"]
    for sentence in ("No rollouts were measured.", "No test was run.", "nothing to compare."):
        assert sentence in text
    assert "dam, stride 1, seed 0: there is no one_step.csv.\n" in text


@pytest.mark.parametrize(
    ("column", "value"), [("steps", "x"), ("steps", "0"), ("time s", ""), ("time s", "-1")]
)
def test_rows_of_a_damaged_table_are_left_out(
    column: str, value: str, copy: Copy, tmp_path: Path
) -> None:
    made = copy(1)
    path = results(made[0]) / "rollout_metrics.csv"
    rows = table(path)
    for line in rows:
        if line["steps"] == "10":
            line[column] = value
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    text = write_report(tmp_path, made, 1)
    assert (
        "dam, stride 1, seed 0: rollout_metrics.csv has rows without steps or time; they are left "
        "out.\n"
    ) in text
    rest = text[text.index("## Rollouts from rest") : text.index("## Rollouts in motion")]
    assert row(rest, "0.1", "5", "acceleration target") and row(rest, "0.8", "40", "truth")


def test_results_on_other_data_are_not_read(copy: Copy, tmp_path: Path) -> None:
    (run,) = copy(1)
    text = write_report(tmp_path / "alone", [run], 1)
    folder = results(run)
    for name in ("a_basin", "z_pool"):
        other = run.folder / "results" / name
        shutil.copytree(folder, other)
        change(other / "one_step.csv", MSE, 1e3)
    assert write_report(tmp_path / "beside", [run], 1) == text


def test_no_run_and_no_folder(tmp_path: Path) -> None:
    assert write_report(tmp_path, [], 3) == "# Ablations\n\n**0 of 3 runs are finished.**\n"
    assert [path.name for path in tmp_path.iterdir()] == ["ablations.md"]
    with pytest.raises(UserError, match="not the folder of a run"):
        write_report(tmp_path, [TrainedRun("dam", 1, 0, tmp_path / "nowhere")], 3)


def test_times_that_do_not_match_are_reported(copy: Copy, tmp_path: Path) -> None:
    first, second = copy(2)
    path = results(second) / "rollout_metrics.csv"
    change(path, "time s", 0.25, steps="10")
    second = TrainedRun("dam", 3, 0, second.folder)
    text = write_report(tmp_path, [first, second], 2)
    times = "0.2 s at stride 1, 0.25 s at stride 3"
    assert f"dam, from rest: the times of the first rows differ: {times}." in text
    assert "the last rows" not in text


def test_figures(runs: list[TrainedRun], copy: Copy, tmp_path: Path) -> None:
    other = TrainedRun("pool", 1, 0, copy(1)[0].folder)
    write_report(tmp_path, [*runs, other], 4)
    for name in ("target", "global_feature", "global_feature_energy"):
        path = tmp_path / f"{name}.png"
        with Image.open(path) as picture:
            assert 600 <= picture.width <= 1600
        assert 10_000 < path.stat().st_size < 1e6
    groups = read_groups([*runs, other])
    dam, wide, pool, empty = target_figure(groups).axes
    assert [axes.get_title() for axes in (dam, wide, pool, empty)] == [
        "dam, 20 ms a step (stride 1), 2 seeds",
        "dam, 40 ms a step (stride 2), 1 seed",
        "pool, 20 ms a step (stride 1), 1 seed",
        "pool, stride 2: not trained",
    ]
    assert dam.get_yscale() == "log" and not empty.axison
    # Two seeds and their mean for each model, and the trivial predictor.
    assert (len(dam.lines), len(wide.lines)) == (7, 3)
    one, two = (dict(run.curve("velocity_mse", "model")) for run in groups[0].runs)
    assert dam.lines[2].get_ydata() == pytest.approx([(one[step] + two[step]) / 2 for step in one])
    assert list(dam.lines[2].get_xdata()) == list(range(1, 9))


def test_the_trivial_predictor_is_the_same_for_all_models(runs: list[TrainedRun]) -> None:
    group = read_groups(runs)[0]
    trivial = trivial_mse(group)
    for run in group.runs:
        for name in ("acceleration", "no global feature"):
            skills = run.curve("skill", name)
            for step, error in run.curve("velocity_mse", name).items():
                assert error / (1 - skills[step]) == pytest.approx(trivial, rel=1e-4)


def test_cost_is_the_median_over_runs(runs: list[TrainedRun], tmp_path: Path) -> None:
    ratios = []
    for run in (run for group in read_groups(runs) for run in group.runs):
        base, twin = (run.curve("cost/step_seconds", name) for name in ("model", "acceleration"))
        ratios.append(twin.iloc[-1] / base.iloc[-1])
    expected = f"{digits(sorted(ratios)[1])} times as long with the acceleration target (3 runs)"
    assert expected in write_report(tmp_path, runs, 3)
