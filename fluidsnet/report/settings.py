"""Sections on a training's configuration and data."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import pandas as pd
import yaml
from lightning import Trainer
from lightning.pytorch.cli import LightningArgumentParser

import fluidsnet
from datamodules.schema import DAMAGE, SPLITS, Header, SceneAttributes, open_valid, simulations
from datamodules.sph import SPHDataModule
from fluidsnet.cli import SEED
from fluidsnet.errors import UserError
from fluidsnet.module import NEEDS, FluidsNet
from fluidsnet.report.page import Folded, Note, Part, Table
from fluidsnet.report.run import CONFIG, Run, flat
from fluidsnet.report.tables import NONE, union
from fluidsnet.reporting.table import Cell

_CONFIGS = Path(fluidsnet.__file__).parents[1] / "configs"
#: Files with the shipped settings; they may not be installed.
_SHIPPED = [it for it in (_CONFIGS / "trainer.yaml", _CONFIGS / "model/paper.yaml") if it.is_file()]
_SOURCE = " and ".join(f"configs/{it.relative_to(_CONFIGS)}" for it in _SHIPPED) or "the defaults"
#: Settings of the data module without a default.
_REQUIRED = ("data.root", "data.voxel_size")
#: Order of the groups of settings.
_ORDER = {"model": 0, "data": 1, "trainer": 2}
_COLUMNS = ("split", "simulations", "frames", "fluid particles", "solid particles", "time s")


def settings(runs: Sequence[Run]) -> Iterator[Part]:
    """Yield the settings that differ between runs, then from the shipped ones, then all."""
    known = {run.name: run.settings for run in runs if run.settings}
    if len(known) > 1:
        table = differing(known)
        caption = "Settings in which the runs differ"
        same = Note("The runs have the same configuration.")
        yield same if table.empty else Table("settings_that_differ", caption, table)
    if known:
        table = changed(known, shipped())
        caption = f"Settings that differ from {_SOURCE}"
        same = Note(f"All settings are those of {_SOURCE}.")
        yield same if table.empty else Table("settings", caption, table, folded=len(known) > 1)
    for run in runs:
        if run.settings:
            yield Folded(f"Full {CONFIG} of {run.name}", run.config)
        else:
            text = f"{run.name} has no {CONFIG} that can be read: fluidsnet fit writes it."
            yield Note(text, missing=True)


def shipped() -> dict[str, str]:
    """Return the shipped settings and the defaults of all others, as a run saves them."""
    parser = LightningArgumentParser()
    parser.add_argument("--config", action="config")
    parser.add_lightning_class_args(Trainer, "trainer")
    parser.add_lightning_class_args(FluidsNet, "model", subclass_mode=True, required=False)
    parser.add_lightning_class_args(SPHDataModule, "data", subclass_mode=True)
    for need in NEEDS:
        parser.link_arguments(f"data.{need}", f"model.init_args.{need}", apply_on="instantiate")
    data = ["--data=datamodules.SPHDataModule", *(f"--{name}=1" for name in _REQUIRED)]
    config = parser.parse_args([*(f"--config={path}" for path in _SHIPPED), *data])
    saved = yaml.safe_load(parser.dump(config, skip_unset=False))
    found = flat({"seed_everything": SEED, **saved})
    return {name: value for name, value in found.items() if name not in _REQUIRED}


def changed(runs: Mapping[str, dict[str, str]], base: dict[str, str]) -> pd.DataFrame:
    """Return the settings of runs that differ from a base, whose values are the last column.

    Of the settings that only the base has, these are the blocks, such as callbacks.
    """
    table = differing({**runs, "as shipped": base})
    absent = (table[[*runs]] == NONE).all(axis="columns")
    return table[~absent | table["as shipped"].str[:1].str.isupper()]


def differing(columns: Mapping[str, dict[str, str]]) -> pd.DataFrame:
    """Return the settings that differ between columns; null is the same as none."""
    names = union(columns.values())
    names.sort(key=lambda name: _ORDER.get(name.partition(".")[0], len(_ORDER)))
    table = pd.DataFrame({column: {**it} for column, it in columns.items()}, names, dtype=object)
    table = table.replace("null", NONE).fillna(NONE)
    table = table[table.nunique(axis="columns") > 1]
    return table.reset_index(names="setting", allow_duplicates=True)


def data(runs: Sequence[Run]) -> Iterator[Part]:
    """Describe the data that each run was trained on."""
    seen: dict[tuple[str, str], Run] = {}
    for run in runs:
        root = run.settings.get("data.root", "")
        stride = run.settings.get("data.stride", "")
        first = seen.setdefault((root, stride), run)
        if not run.settings:
            text = f"The data that {run.name} was trained on are unknown without its {CONFIG}."
            yield Note(text, missing=True)
        elif first is not run and first.settings:
            yield Note(f"{run.name} has the same data as {first.name}.")
        else:
            yield from _describe(run, Path(root), int(stride) if stride.isdecimal() else 1)


def _describe(run: Run, root: Path, stride: int) -> Iterator[Part]:
    text = f"{run.prefix}Trained on the data of {root}."
    rows: list[list[Cell]] = []
    scenes: list[SceneAttributes] = []
    for path in (root / f"{split}.h5" for split in SPLITS):
        if not path.exists():
            continue
        try:
            with open_valid(path) as file:
                header = Header.read(file)
                groups = [file[name] for name in simulations(file)]
                scenes += map(SceneAttributes.read, groups)
                frames = [int(group["position"].shape[0]) for group in groups]
                fluid = _range([int(group["position"].shape[1]) for group in groups])
                solid = _range([int(group["solid_position"].shape[-2]) for group in groups])
        except (UserError, *DAMAGE) as error:
            text += f" {path.name} cannot be read: {error}"
        else:
            time = sum(count - 1 for count in frames) * header.dt
            rows.append([path.stem, len(groups), sum(frames), fluid, solid, time])
    if not rows:
        yield Note(f"{text} No data file is found there from the working folder.", missing=True)
        return
    sizes = dict.fromkeys(map(_size, scenes))
    yield Note(
        f"{text} Scene {header.scene} in {_range_of(list(sizes))}, solver {header.solver}, "
        f"particle radius {header.particle_radius:g} m; a frame every {1000 * header.dt:g} ms, "
        f"a step every {1000 * header.dt * stride:g} ms."
    )
    table = pd.DataFrame(rows, columns=_COLUMNS, dtype=object)
    yield Table(f"data{run.suffix}", f"Data files of {run.name}", table)


def _size(scene: SceneAttributes) -> str:
    corners = zip(scene.domain_lower, scene.domain_upper, strict=True)
    return " × ".join(f"{high - low:g}" for low, high in corners) + " m"


def _range_of(sizes: list[str]) -> str:
    return sizes[0] if len(sizes) == 1 else f"{len(sizes)} boxes of different sizes"


def _range(counts: list[int]) -> str:
    least, most = min(counts, default=0), max(counts, default=0)
    return f"{least:,}" if least == most else f"{least:,} to {most:,}"
