"""The document about one run, or about several side by side."""

from __future__ import annotations

from collections.abc import Sequence

from fluidsnet.report.data_set import data_settings, describe
from fluidsnet.report.document import Document, Folded, Note, Section, Table
from fluidsnet.report.results import (
    glance_section,
    one_step_section,
    picture_section,
    rollout_section,
)
from fluidsnet.report.run import CONFIG, Run
from fluidsnet.report.settings import SHIPPED, changed, differing, flat, shipped
from fluidsnet.report.training import ablation_section, training_section


def compose(runs: Sequence[Run]) -> Document:
    """Everything that was logged, in the order of a reader's questions."""
    names = ", ".join(run.name for run in runs)
    several = len(runs) > 1
    sections = [
        glance_section(runs),
        one_step_section(runs),
        rollout_section(runs),
        picture_section(runs),
        training_section(runs),
        ablation_section(runs),
        _settings_section(runs),
        _data_section(runs),
    ]
    unread = [Note(f"{run.name}: {words}") for run in runs for words in run.unread]
    if unread:
        sections.append(Section("Files not read in full", [*unread]))
    where = ", ".join(str(run.folder) for run in runs)
    lead = f"{len(runs)} runs side by side: {where}." if several else f"From {where}."
    return Document(f"FluidsNet: {names}", lead, sections)


def _settings_section(runs: Sequence[Run]) -> Section:
    """What differs between the runs, then from what is shipped, then everything."""
    section = Section("Configuration")
    known = {run.name: flat(run.config) for run in runs if run.config is not None}
    if len(known) > 1:
        grid = differing(known)
        if grid is None:
            section.parts.append(Note("The runs have the same configuration."))
        else:
            caption = "Settings in which the runs differ"
            section.parts.append(Table("settings_that_differ", caption, grid))
    base = shipped() if known else {}
    files = " and ".join(f"configs/{name}" for name in SHIPPED)
    source = files if base else "the classes' own defaults"
    for run in runs:
        if run.config is None:
            words = f"{run.name} has no {CONFIG} that can be read: fluidsnet fit writes it."
            section.parts.append(Note(words, missing=True))
            continue
        grid = changed(known[run.name], base)
        if grid is None:
            section.parts.append(Note(f"{run.name} is configured as shipped ({source})."))
        else:
            name = "settings" if len(runs) == 1 else f"settings_{run.name}"
            caption = f"What {run.name} sets other than {source}"
            section.parts.append(Table(name, caption, grid, folded=len(known) > 1))
        section.parts.append(Folded(f"All of {run.name}'s {CONFIG}", run.config_text))
    return section


def _data_section(runs: Sequence[Run]) -> Section:
    """The data of each run; of several on the same, once."""
    section = Section("Data")
    seen: dict[str, str] = {}
    for run in runs:
        if run.config is None:
            words = f"{run.name} does not say what its data are, having no {CONFIG}."
            section.parts.append(Note(words, missing=True))
            continue
        sentences, grid = describe(run.config)
        key = str((sentences, data_settings(run.config).get("root")))
        if key in seen:
            section.parts.append(Note(f"{run.name} has the same data as {seen[key]}."))
            continue
        seen[key] = run.name
        begin = f"{run.name}: " if len(runs) > 1 else ""
        section.parts += [
            Note(f"{begin}{' '.join(sentences)}", missing=grid is None),
        ]
        if grid is not None:
            name = "data" if len(runs) == 1 else f"data_{run.name}"
            section.parts.append(Table(name, f"What {run.name} was given", grid))
    return section
