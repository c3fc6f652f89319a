"""Tests of work in several processes."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from fluidsnet.errors import UserError
from fluidsnet.export.in_order import in_order


@pytest.mark.parametrize(("workers", "ahead"), [(1, 1), (2, 5)])
def test_results_keep_their_order_and_items_are_read_as_needed(workers: int, ahead: int) -> None:
    read = 0

    def items() -> Iterator[int]:
        nonlocal read
        for item in range(-20, 0):
            read += 1
            yield item

    for index, result in enumerate(in_order(abs, items(), workers)):
        assert result == 20 - index
        assert read <= index + ahead
    assert read == 20


def test_a_killed_process_is_one_sentence() -> None:
    with pytest.raises(UserError, match=r"One of 2 processes was killed.*fewer --workers"):
        list(in_order(os._exit, [9, 9, 9], 2))
