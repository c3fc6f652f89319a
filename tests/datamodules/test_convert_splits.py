"""Tests of how `fluidsnet convert` assigns simulations to splits."""

from __future__ import annotations

import pytest

from datamodules.convert.splits import assign
from fluidsnet.errors import UserError

NAMES = [f"sim_{number:02d}" for number in range(20)]


def test_names_and_patterns() -> None:
    found = assign(NAMES, ["val=sim_03", "train=sim_00,sim_1*"])
    assert found == {"train": ["sim_00", *NAMES[10:]], "val": ["sim_03"]}


def test_shares_use_each_simulation_once_and_repeat() -> None:
    found = assign(NAMES, ["0.8", "0.1", "0.1"])
    assert [len(found[name]) for name in ("train", "val", "test")] == [16, 2, 2]
    assert sorted(name for names in found.values() for name in names) == NAMES
    assert found == assign(NAMES, ["0.8", "0.1", "0.1"])
    assert assign(NAMES, ["0", "0", "1"]) == {"test": NAMES}


def test_folders() -> None:
    names = ["train/a", "valid/c", "train/b/x", "test/d"]
    found = {"train": ["train/a", "train/b/x"], "val": ["valid/c"], "test": ["test/d"]}
    assert assign(names, None) == found


@pytest.mark.parametrize(
    ("split", "words"),
    [
        (None, "no folders for its splits; say which"),
        (["train=gone"], "no simulation is 'gone'; simulations: sim_00"),
        (["train=sim_0*", "val=sim_03"], "puts 'sim_03' into a data set 2 times"),
        (["valid=sim_03"], "--split valid=sim_03 is not understood"),
        (["train=sim_00", "0.5"], "--split 0.5 is not understood"),
        (["a", "b", "c"], "--split a b c is not understood"),
        (["0.5", "0.5"], "must be three, and add up to 1"),
        (["0.5", "0.6", "-0.1"], "must be three, and add up to 1"),
        (["0.98", "0.01", "0.01"], "val would be empty"),
    ],
)
def test_mistakes_are_named(split: list[str] | None, words: str) -> None:
    with pytest.raises(UserError, match=words):
        assign(NAMES, split)
