"""Progress of long work: a bar in a terminal, a line every ten seconds elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

from tqdm import tqdm

#: Seconds between lines where output is not a terminal.
INTERVAL = 10.0


class Progress(tqdm):  # type: ignore[type-arg]
    """A tqdm bar that writes whole lines where its file is not a terminal.

    A log file then has no carriage returns and no blank line where a bar was.

    Args:
        *args: As for `tqdm.tqdm`.
        **kwargs: As for `tqdm.tqdm`.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        file = kwargs.get("file") or sys.stderr
        self._interactive = bool(file.isatty())
        if not self._interactive:
            kwargs |= {"mininterval": INTERVAL, "maxinterval": INTERVAL, "dynamic_ncols": False}
            kwargs.setdefault("bar_format", "{desc}: {n_fmt}/{total_fmt} {unit}, {rate_fmt}")
        super().__init__(*args, **kwargs)

    @staticmethod
    def status_printer(file: Any) -> Callable[[str], None]:
        """Return a function that shows a status in place of the last one, or on its own line."""
        if file.isatty():
            shown: Callable[[str], None] = tqdm.status_printer(file)
            return shown

        def write(status: str) -> None:
            if status.strip():
                file.write(f"{status}\n")
                file.flush()

        return write

    def close(self) -> None:
        """Show the last state and end the bar."""
        if self._interactive or self.disable:
            super().close()
            return
        if self.leave:
            self.display()
        # tqdm would end the line that the bar was on.
        self.disable = True
        self._decr_instances(self)  # type: ignore[attr-defined]
