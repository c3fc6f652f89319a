"""``fluidsnet trade``: error against cost of models, priors and the solver, in one run."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import asdict
from datetime import datetime
from hashlib import sha256
from pathlib import Path

from datamodules.generate.solver import load_solver
from datamodules.reader import FrameReader
from fluidsnet.baselines import TRIVIAL_PREDICTORS
from fluidsnet.errors import UserError
from fluidsnet.progress import Progress
from fluidsnet.studies.machine import BUSY, OtherLoad, cpu_model, versions
from fluidsnet.studies.parser import study_parser
from fluidsnet.studies.trade.figure import draw
from fluidsnet.studies.trade.measure import Measured, measure
from fluidsnet.studies.trade.options import TradeOptions
from fluidsnet.studies.trade.points import ModelSteps, Point, Solver, Trivial, check_drawn
from fluidsnet.studies.trade.report import NEAR, Results, write_report

#: Options that change what is measured of a point.
_MEASURE = ("simulations", "every", "horizon", "steps", "marks")


def trade_command(arguments: list[str]) -> None:
    """Run the study and print its table.

    Raises:
        UserError: An option cannot be used, or the solver is needed and not installed.
    """
    parser = study_parser(
        "trade",
        "Measure error and cost of models, of priors, and of SPlisHSPlasH with steps and "
        "tolerances of your choice, from the same true states and along the same rollouts. "
        "Points that are finished are kept in the output folder. Run nothing else meanwhile. "
        "A first try: fluidsnet trade --data data/box_drops/test.h5 --models "
        '"[{model: configs/model/prior.yaml}]" --simulations 1',
        TradeOptions,
    )
    parsed = vars(parser.instantiate(parser.parse_args(arguments)))
    parsed.pop("config")
    study = Study(TradeOptions(**parsed))
    study.run()
    print((study.folder / "trade.md").read_text(encoding="utf-8"))
    print(f"Written to {study.folder}: trade.md, trade.csv and trade.png.")


class Study:
    """All points, one after the other; the tables are written after each.

    Args:
        options: What to measure.

    Raises:
        UserError: The data cannot be read, a model cannot be loaded, or the solver is needed and
            not installed.
    """

    def __init__(self, options: TradeOptions) -> None:
        self.options, self.folder = options, Path(options.output)
        self._reader = FrameReader(Path(options.data))
        self._simulations = list(self._reader.frames)[: options.simulations]
        self.points: list[Point] = [*map(Trivial, TRIVIAL_PREDICTORS)]
        if options.solvers:
            load_solver()
            for simulation in self._simulations:
                check_drawn(self._reader.path, simulation)
        self.points += [
            Solver(point, self._reader.path, options.threads) for point in options.solvers
        ]
        self.points += [
            ModelSteps(point, self._reader, options.threads) for point in options.models
        ]
        for point in self.points:
            if point.stride > options.horizon:
                raise UserError(
                    f"--horizon is {options.horizon}, and {point.label} steps {point.stride} "
                    f"frames at once; set --horizon {point.stride} or more."
                )
        self.results: dict[str, Results] = {}
        labels = [point.label for point in self.points]
        if len(set(labels)) < len(labels):
            raise UserError("Two points have the same label; give one another `label`.")

    def run(self) -> None:
        """Measure the points that are not finished yet; write the tables after each."""
        count = len(self.points) * len(self._simulations)
        with Progress(total=count, unit="simulation") as bar:
            for point in self.points:
                bar.set_description(point.label)
                self.results[point.label] = self._measured(point, bar)
                self.write()

    def write(self) -> None:
        """Write tables and figure."""
        options, header = self.options, self._reader.header
        notes = [
            f"{datetime.now():%Y-%m-%d}, {cpu_model()}, {options.threads} threads; {versions()}",
            f"{options.data}, {len(self._simulations)} simulations, {self._particles()} fluid "
            f"particles on average, a frame each {1000 * header.dt:g} ms; truth: {header.solver} "
            f"with steps of {1000 * header.solver_parameters.get('timeStepSize', 0):g} ms",
        ]
        # The fewest frames after which all points have a state.
        strides = {point.stride for point in self.points}
        shared = [frame for frame in NEAR if all(frame % stride == 0 for stride in strides)]
        kinds = {point.label: point.kind for point in self.points}
        draw(
            self.folder / "trade.png",
            kinds,
            self.results,
            min(shared, default=options.horizon),
            max(options.marks),
        )
        write_report(self.folder, notes, options, self.results)

    def _particles(self) -> str:
        counts = [it.fluid for measured in self.results.values() for it in measured.values()]
        return f"{sum(counts) / max(len(counts), 1):,.0f}"

    def _measured(self, point: Point, bar: Progress) -> Results:
        """Return the results of a point, from its file if it is finished."""
        path = self.folder / "points" / f"{self._key(point)}.json"
        if path.exists():
            bar.update(len(self._simulations))
            stored = json.loads(path.read_text())["results"]
            return {name: _from_json(values) for name, values in stored.items()}
        results: Results = {}
        with OtherLoad() as load:
            for simulation in self._simulations:
                results[simulation] = measure(
                    point, self._reader, simulation, self.options, _refresh(bar)
                )
                bar.update()
        if load.cores > BUSY:
            bar.write(
                f"WARNING: others took {load.cores:.1f} cores during {point.label}.",
                file=sys.stderr,
            )
        path.parent.mkdir(parents=True, exist_ok=True)
        stored = {"label": point.label, "settings": point.settings}
        stored["results"] = {name: asdict(values) for name, values in results.items()}
        partial = path.with_suffix(".tmp")
        partial.write_text(json.dumps(stored, indent=1))
        partial.replace(path)
        return results

    def _key(self, point: Point) -> str:
        """Return a name for the results of a point, which changes with what they depend on."""
        status = self._reader.path.stat()
        depends = {
            "point": point.settings,
            "measure": {name: getattr(self.options, name) for name in _MEASURE},
            "data": [str(self._reader.path.resolve()), status.st_size, status.st_mtime],
        }
        return sha256(json.dumps(depends, sort_keys=True).encode()).hexdigest()[:16]


def _refresh(bar: Progress) -> Callable[[], None]:
    def advance() -> None:
        bar.refresh()

    return advance


def _from_json(values: dict[str, object]) -> Measured:
    """Return results that were stored as JSON, whose keys are text."""
    measured = Measured(**values)  # type: ignore[arg-type]
    for result, by_frames in measured.values.items():
        measured.values[result] = {int(frames): value for frames, value in by_frames.items()}
    return measured
