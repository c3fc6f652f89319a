"""Progress of long work: a bar in a terminal, a line every ten seconds elsewhere."""

from __future__ import annotations

import sys
import time
from typing import Any

from tqdm import tqdm

#: Seconds between lines where output is not a terminal.
INTERVAL = 10.0


class Progress(tqdm):  # type: ignore[type-arg]
    """A tqdm bar that writes whole lines where its file is not a terminal.

    It then writes a line every `INTERVAL` seconds and one at the end, without carriage returns.
    A bar with ``leave=False`` writes no last line, so that short ones write nothing.

    Args:
        *args: As for `tqdm.tqdm`.
        **kwargs: As for `tqdm.tqdm`.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self._terminal = bool((kwargs.get("file") or sys.stderr).isatty())
        self._written, self._line = time.monotonic(), ""
        # tqdm puts no space between a rate and its unit.
        kwargs["unit"] = f" {kwargs.get('unit', 'it').strip()}"
        if not self._terminal:
            description = (kwargs.get("desc") or "").rstrip(": ")
            kwargs["desc"] = f"{description}: " if description else ""
            kwargs["bar_format"] = "{desc}{n_fmt}/{total_fmt}, {rate_fmt}{postfix}"
        super().__init__(*args, **kwargs)

    def display(self, msg: str | None = None, pos: int | None = None) -> None:
        """Show the status; in a file only if the last line is `INTERVAL` seconds old."""
        if self._terminal:
            super().display(msg, pos)
        elif time.monotonic() - self._written >= INTERVAL:
            self._write()

    def __str__(self) -> str:
        status = super().__str__().replace("s/ ", " s/")
        return status if self._terminal else " ".join(status.split())

    def clear(self, nolock: bool = False) -> None:
        """Remove the bar from the terminal."""
        if self._terminal:
            super().clear(nolock)

    def close(self) -> None:
        """Show the last status and end the bar."""
        if self.disable:
            return
        if self._terminal:
            super().close()
            if not self.leave:
                # tqdm moves the cursor back for the bar of the first line only.
                self.fp.write("\r")
                self.fp.flush()
            return
        if self.leave:
            self._write()
        # tqdm's `close` would write an empty line.
        self.disable = True
        self._decr_instances(self)  # type: ignore[attr-defined]

    def _write(self) -> None:
        self._written = time.monotonic()
        line = str(self)
        if line != self._line:
            self._line = line
            self.fp.write(f"{line}\n")
            self.fp.flush()
