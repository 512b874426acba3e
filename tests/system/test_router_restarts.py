"""A router that is killed again and again: tokens and answers are right after each start (fifty in the benchmark)."""

from __future__ import annotations

import pytest

from benchmarks.system.restarts import restart_often

pytestmark = [pytest.mark.system, pytest.mark.whole, pytest.mark.slow]


def test_after_each_restart_everybody_is_seen_once() -> None:
    assert len(restart_often(3, seed=1)) == 3  # it raises when one is missing, or seen twice
