"""What the vehicle's motion shows: speed and yaw rate with the device that told them."""

from __future__ import annotations

from collections.abc import Iterator

from common.bus.look import Look, PeriodSamples, collect
from services.jetson.ego.config import EgoConfig
from services.jetson.ego.pipeline import Motion
from services.jetson.ego.source import open_source


def looks(config: EgoConfig, seconds: float) -> Iterator[Look]:
    """One ``Look`` a period, with the newest motion of it.

    Raises:
        ConfigError: the source cannot be opened as it is written.
    """
    for seen in collect(lambda report: open_source(config, report), seconds):
        yield describe(seen, seen.items[-1][1]) if seen.items else seen.nothing("motion")


def describe(seen: PeriodSamples[tuple[int, Motion]], newest: Motion) -> Look:
    """The figures of one period; a device that says nothing is named by the source itself."""
    speed = "no speed" if newest.speed_mps is None else f"{newest.speed_mps:+.2f} m/s by {newest.speed_origin}"
    turn = "no yaw rate"
    if newest.yaw_rate_radps is not None:
        turn = f"{newest.yaw_rate_radps:+.3f} rad/s by {newest.yaw_rate_origin}"
    figures = f"{speed}, {turn}, {seen.rate_hz:.0f} times a second"
    if newest.reason:
        return Look(
            sees=False, what=f"{figures}; {newest.reason}", do="push the vehicle by hand: does the device count?"
        )
    return Look(sees=True, what=figures)
