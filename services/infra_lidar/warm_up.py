"""Compile or load every kernel before the first real frame, and say so. Compiled kernels are kept on disk."""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np
from msgspec.structs import replace
from numba.core import event
from numba.core.registry import cpu_target

from common.stopwatch import Stopwatch
from services.infra_lidar.compile_together import collecting_seldom, compile_together
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.kernels_returns import beams_seen
from services.infra_lidar.pipeline import InfraLidarPipeline
from services.infra_lidar.shipped import lay_out_own
from services.infra_lidar.warm_up_parts import (
    FRAME_NS,
    LATER,
    STEPS,
    compile_packets,
    endless,
    follow_people,
    know_people,
    made_up_frame,
)

log = logging.getLogger(__name__)

# Numba imports the larger part of itself with the first kernel: here, that is with all other imports.
cpu_target.target_context.refresh()


def warm_up(config: InfraLidarConfig, tell: Callable[[str], None], learned: bool = True) -> float:
    """Run a small made-up frame through a pipeline of its own; returns the milliseconds it took.

    Without a ``learned`` scene what it needs may be compiled later, while the service learns one.
    """

    def say(text: str) -> None:
        log.info(text)
        tell(text)

    watch = Stopwatch()
    background = replace(config.background, learn_s=0.1, min_frames=5, azimuth_cells=90)
    calibration = replace(config.calibration, frames=1, hypotheses=16)
    small = replace(config, calibration=calibration, background=background, T_map_sensor=())
    lay_out_own()
    with collecting_seldom():
        if _compiled_before():
            say("loading kernels")
        else:
            say("compiling kernels: on the first start on this machine, up to half a minute")
            compile_together(small, () if learned else LATER)
            small = small if learned else endless(small)
        with event.install_listener("numba:compile", _Compiling(say)):
            run_whole(small)
    watch.lap("warm-up")
    log.info("kernels ready after %.1f s", watch.stage_ms["warm-up"] / 1e3)
    return watch.stage_ms["warm-up"]


def run_whole(config: InfraLidarConfig) -> None:
    """A made-up scene through a whole pipeline, and what comes seldom."""
    frame, pipeline = made_up_frame(), InfraLidarPipeline(config)
    for k in STEPS:
        pipeline.process((10 + k) * FRAME_NS, frame)
    follow_people(pipeline.tracker)
    know_people(pipeline.classifier)
    compile_packets(config)


def _compiled_before() -> bool:
    """Whether the smallest kernel comes from the disk."""
    missed = sum(beams_seen.stats.cache_misses.values())  # type: ignore[attr-defined]
    beams_seen(np.zeros((1, 2), np.float32)[:, 0], np.zeros(256, bool))
    return bool(sum(beams_seen.stats.cache_misses.values()) == missed)  # type: ignore[attr-defined]


class _Compiling(event.Listener):
    """Says once that kernels are compiled after all: an update has changed what some of them are made from."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell: Callable[[str], None] | None = tell

    def on_start(self, event: event.Event) -> None:
        """A kernel that is not on the disk."""
        if self._tell is not None:
            self._tell("compiling the kernels that an update has changed: up to half a minute")
            self._tell = None

    def on_end(self, event: event.Event) -> None:
        """It is compiled."""
