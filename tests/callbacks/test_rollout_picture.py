"""Test of the arguments of RolloutPicture; test_predict_results.py has the pictures."""

from __future__ import annotations

import pytest

from callbacks import RolloutPicture
from fluidsnet.errors import UserError


@pytest.mark.parametrize("times", [[], [-0.1], [0.5, 1.1]])
def test_times_that_are_no_shares_are_refused(times: list[float]) -> None:
    with pytest.raises(UserError, match="give at least one share of the rollout's length"):
        RolloutPicture(times)
