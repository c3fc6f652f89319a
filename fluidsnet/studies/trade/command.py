"""``fluidsnet trade``: error against cost of models, priors and the solver, in one run."""

from __future__ import annotations

from fluidsnet.folder_lock import FolderLock
from fluidsnet.studies.parser import parse_options
from fluidsnet.studies.trade.options import TradeOptions
from fluidsnet.studies.trade.recommend import recommend_command
from fluidsnet.studies.trade.study import Study


def trade_command(arguments: list[str]) -> None:
    """Run the study and print its table; or recommend a point of a finished study.

    Raises:
        UserError: An option cannot be used, or the solver is needed and not installed.
    """
    if arguments[:1] == ["recommend"]:
        recommend_command(arguments[1:])
        return
    options = parse_options(
        "trade",
        "Measure error and cost of models, of priors, and of SPlisHSPlasH with steps and "
        "tolerances of your choice, from the same true states and along the same rollouts. "
        "Points that are finished are kept in the output folder. Run nothing else meanwhile. "
        "`fluidsnet trade recommend --help` tells how to ask a finished study. "
        "A first try: fluidsnet trade --data data/box_drops/test.h5 --models "
        '"[{model: box_drops}]" --quick true',
        TradeOptions,
        arguments,
    )
    study = Study(options)
    with FolderLock(study.folder):
        study.run()
    print((study.folder / "trade.md").read_text(encoding="utf-8"))
    print(f"Written to {study.folder}: trade.html, trade.md, trade.csv and trade.png.")
