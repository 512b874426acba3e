"""Random worlds for fusion: bodies that come and go, sensors that fail in every way, and what must hold all the same.

    python -m spotter_tools.random_worlds --count 1000 --seconds 60

A world is its seed. Each sensor sees the bodies that it can see (a low box only the lidar, a walker behind glass only
the radar), and sends fusion's own pipeline real messages in simulated time. Three things are counted and have to be
zero: SAFE close to a body that somebody reported and nobody saw gone; an alarm about a body that was seen gone;
exceptions.
"""

from __future__ import annotations

from spotter_tools.random_worlds.judge import Outcome
from spotter_tools.random_worlds.run import run

__all__ = ["Outcome", "run"]
