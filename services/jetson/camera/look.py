"""What the camera shows: picture size and rate, what the network runs on and how long it takes, and what is ahead."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import msgspec

from common.bus.look import Look, PeriodSamples, collect
from common.bus.status import Report
from common.messages import CameraDetections
from services.jetson.camera.config import CameraConfig
from services.jetson.camera.frames import Frame
from services.jetson.camera.pipeline import CameraPipeline
from services.jetson.camera.source import fitted, open_source


def looks(config: CameraConfig, seconds: float) -> Iterator[Look]:
    """One ``Look`` a period. The network sees the newest picture of each period, so that it does not set the rate.

    Raises:
        ConfigError: the source or the network cannot be opened as it is written.
    """
    config = fitted(config)
    one_a_period = msgspec.structs.replace(config.health, slow_below_hz=0.0)  # the rate is judged by all that come
    pipeline = CameraPipeline(msgspec.structs.replace(config, health=one_a_period))

    def frames(report: Report) -> Iterator[Frame]:
        source, _ = open_source(config, report)
        yield from source(threading.Event())

    for seen in collect(frames, seconds):
        if seen.items:
            yield describe(config, seen, pipeline.process(seen.items[-1].stamp_ns, seen.items[-1].image))
        else:
            yield seen.nothing("picture")


def describe(config: CameraConfig, seen: PeriodSamples[Frame], newest: CameraDetections) -> Look:
    """The figures of one period, with the newest picture's detections."""
    width_px, height_px = newest.image_size_px
    network = config.detector.model or "demo network"
    milliseconds = newest.stage_ms.get("inference")
    took = f"{network} on {newest.provider.removesuffix('ExecutionProvider')}"
    took += f" in {milliseconds:.0f} ms" if milliseconds is not None else ""
    found = ", ".join(f"{one.label} {one.distance_m:.1f} m" for one in newest.detections[:3]) or "nothing detected"
    rate = f"{width_px} x {height_px}, {seen.rate_hz:.1f} pictures a second, brightness {newest.brightness:.0f}"
    if 0.0 < seen.rate_hz < config.health.slow_below_hz:
        return Look(sees=False, what=f"{rate}; {took}; too slow", do="more light (long exposures), USB 3, smaller size")
    if newest.state == "online":
        return Look(sees=True, what=f"{rate}; {took}; {found}")
    return Look(
        sees=False, what=f"{rate}; {took}; {newest.reason}", do="see the reason: light, lens cover, focus, direction"
    )
