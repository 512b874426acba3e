"""Many random worlds at once: ``python -m spotter_tools.random_worlds --count 1000 --seconds 60``."""

from __future__ import annotations

import argparse
import os
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial

from spotter_tools.random_worlds.run import run

WORST = 10


def main() -> int:
    """Print the totals and the worst worlds; exit code 1 when something was wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    given = parser.parse_args()
    begun_s = time.monotonic()
    seeds = range(given.first, given.first + given.count)
    with ProcessPoolExecutor(given.jobs) as pool:
        outcomes = list(pool.map(partial(run, seconds=given.seconds), seeds, chunksize=4))
    steps = sum(one.steps for one in outcomes)
    alarmed_s = sum(one.alarmed_s for one in outcomes)
    print(f"{given.count} worlds of {given.seconds:g} s, {steps} verdicts, {time.monotonic() - begun_s:.0f} s")
    print(f"SAFE close to a body that was reported and not seen gone: {sum(one.unsafe for one in outcomes)}")
    print(f"alarms that outlived what was seen gone:                  {sum(one.outlived for one in outcomes)}")
    print(f"exceptions:                                               {sum(one.errors for one in outcomes)}")
    print(f"most changes in a second of steady input:                 {max(one.worst_changes for one in outcomes)}")
    print(f"share of the time not SAFE:                               {alarmed_s / given.seconds / given.count:.2f}")
    for one in sorted(outcomes, key=lambda one: (-one.wrong, -one.worst_changes))[:WORST]:
        print(
            f"  seed {one.seed}: {one.unsafe} / {one.outlived} / {one.errors}, {one.worst_changes} changes  {one.first}"
        )
    return int(any(one.wrong for one in outcomes))


if __name__ == "__main__":
    raise SystemExit(main())
