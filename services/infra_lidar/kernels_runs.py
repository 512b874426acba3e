"""Runs of equal numbers: what comes one after the other from a lidar is mostly of one cell and one label."""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inner
from services.infra_lidar.vectors import LANES, lane_count, lanes, load, store_chosen


@inner
def find_runs(values, begin):  # type: ignore[no-untyped-def]
    """begin (runs + 1,) int32, with room for a vector more: where another number begins than stood before, and the end.
    Returns how many runs the values (N,) int32 are."""
    n, runs = len(values), 0
    if n > 0:
        begin[0], runs = 0, 1
    whole = max((n - 1) - (n - 1) % LANES, 0)
    for i in range(0, whole, LANES):
        new = load(values, i) != load(values, i + 1)
        store_chosen(begin, runs, lanes() + np.int32(i + 1), new)
        runs += lane_count(new)
    for i in range(whole + 1, n):
        begin[runs] = i
        runs += values[i] != values[i - 1]
    begin[runs] = n
    return runs
