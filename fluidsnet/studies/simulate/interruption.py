"""Ctrl-C that ends a loop after the current step."""

from __future__ import annotations

import signal
from types import FrameType
from typing import Any, Self, final


@final
class Interruption:
    """Context manager in which the first SIGINT sets a mark and the second raises.

    Attributes:
        requested: The signal came.
    """

    requested = False

    def __enter__(self) -> Self:
        self._before: Any = signal.signal(signal.SIGINT, self._request)
        return self

    def __exit__(self, *exception: object) -> None:
        signal.signal(signal.SIGINT, self._before)

    def _request(self, number: int, frame: FrameType | None) -> None:
        if self.requested:
            raise KeyboardInterrupt
        self.requested = True
