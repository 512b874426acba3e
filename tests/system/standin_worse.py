"""The stand-in, made worse on purpose: `standin_worse.py slow | late | mortal`."""

import os
import sys

import standin_radar as radar

LATE_NS, LAST_WORDS = 150_000_000, 12
honest_tracks = radar.tracks
spoken_live = 0


def late(seq, stamp_ns):
    """What it says is older than it has to be."""
    return honest_tracks(seq, stamp_ns - LATE_NS)


def mortal(seq, stamp_ns):
    """As good as any, until a second after its promotion."""
    global spoken_live
    spoken_live += radar.promoted.is_set()
    if spoken_live > LAST_WORDS:
        os._exit(9)
    return honest_tracks(seq, stamp_ns)


if sys.argv[1] == "slow":
    radar.PERIOD_S = 0.2
else:
    radar.tracks = {"late": late, "mortal": mortal}[sys.argv[1]]
radar.main()
