"""Splits of a data set: which simulation is in which file."""

from __future__ import annotations

from fnmatch import fnmatchcase

import numpy as np

from datamodules.schema import SPLITS
from fluidsnet.errors import UserError

#: Names of folders that are splits.
_FOLDERS = {
    "train": "train",
    "training": "train",
    "val": "val",
    "valid": "val",
    "validation": "val",
    "test": "test",
}


def assign(names: list[str], split: list[str] | None) -> dict[str, list[str]]:
    """Return the names of the simulations of each split that has any.

    Without an option, the splits are folders: simulations in ``train/``, ``valid/`` and so on.

    Args:
        names: Names of all simulations.
        split: Names or patterns of each split, such as ``train=a,b``, ``val=c*``, ``test=d``; or
            three shares, such as ``0.8``, ``0.1``, ``0.1``, for a random assignment that is the
            same each time.

    Raises:
        UserError: It cannot be understood, or does not fit the simulations.
    """
    if split is None:
        return _by_folder(names)
    if all("=" not in part for part in split):
        return _by_share(names, split)
    found: dict[str, list[str]] = {}
    for part in split:
        name, _, patterns = part.partition("=")
        if name not in SPLITS or not patterns:
            raise UserError(f"--split {part} is not understood; {_usage(names)}")
        for pattern in patterns.split(","):
            matches = [it for it in names if fnmatchcase(it, pattern)]
            if not matches:
                raise UserError(f"--split {part}: no simulation is {pattern!r}; {_known(names)}")
            found.setdefault(name, []).extend(matches)
    for one in names:
        count = sum(matched.count(one) for matched in found.values())
        if count > 1:
            raise UserError(f"--split puts {one!r} into a data set {count} times; name it once.")
    return {name: sorted(found[name]) for name in SPLITS if name in found}


def _by_folder(names: list[str]) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for name in names:
        folder = _FOLDERS.get(name.partition("/")[0].lower()) if "/" in name else None
        if folder is None:
            raise UserError(f"the data has no folders for its splits; {_usage(names)}")
        found.setdefault(folder, []).append(name)
    return {name: sorted(found[name]) for name in SPLITS if name in found}


def _by_share(names: list[str], split: list[str]) -> dict[str, list[str]]:
    try:
        shares = np.array([float(part) for part in split])
    except ValueError as error:
        raise UserError(f"--split {' '.join(split)} is not understood; {_usage(names)}") from error
    if len(shares) != 3 or (shares < 0).any() or not np.isclose(shares.sum(), 1):
        raise UserError(
            f"--split {' '.join(split)}: the shares of train, val and test must be three, and add "
            "up to 1."
        )
    ends = np.round(np.cumsum([0, *shares]) * len(names)).astype(int)
    order = np.random.default_rng(0).permutation(len(names))
    found = {
        name: sorted(names[index] for index in order[first:end])
        for name, first, end in zip(SPLITS, ends[:-1], ends[1:], strict=True)
    }
    for name, share in zip(SPLITS, shares, strict=True):
        if share and not found[name]:
            raise UserError(
                f"--split {' '.join(split)}: {name} would be empty, with {len(names)} "
                f"simulation(s); {_usage(names)}"
            )
    return {name: chosen for name, chosen in found.items() if chosen}


def _usage(names: list[str]) -> str:
    return (
        "say which simulation is in which file, as in `--split train=a,b val=c test=d` or "
        f"`--split 0.8 0.1 0.1`; {_known(names)}"
    )


def _known(names: list[str]) -> str:
    more = f" and {len(names) - 6} more" if len(names) > 6 else ""
    return f"simulations: {', '.join(names[:6])}{more}."
