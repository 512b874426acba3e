"""Compile or load every kernel before the first real frame, and say so."""

from __future__ import annotations

import logging
from collections.abc import Callable

import msgspec
import numpy as np

from common.stopwatch import Stopwatch
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.pipeline import InfraLidarPipeline

log = logging.getLogger(__name__)


def warm_up(config: InfraLidarConfig, tell: Callable[[str], None]) -> float:
    """Run a small made-up frame through a pipeline of its own; returns the milliseconds it took."""
    tell("loading kernels; on the first start on this machine they are compiled, which takes about 40 s")
    watch = Stopwatch()
    background = msgspec.structs.replace(config.background, learn_s=0.1, min_frames=5, azimuth_cells=90)
    calibration = msgspec.structs.replace(config.calibration, frames=1, hypotheses=16)
    pipeline = InfraLidarPipeline(
        msgspec.structs.replace(config, calibration=calibration, background=background, T_map_sensor=())
    )
    frame = made_up_frame()
    for k in range(9):  # to the end of learning and beyond
        pipeline.process(1_000_000_000 + k * 100_000_000, frame)
    watch.lap("warm-up")
    log.info("kernels ready after %.1f s", watch.stage_ms["warm-up"] / 1e3)
    return watch.stage_ms["warm-up"]


def made_up_frame() -> np.ndarray:
    """(N, 5) float32: a flat road 4 m below the sensor with three boxes on it."""
    generator = np.random.default_rng(7)
    road = np.column_stack([generator.uniform(-20, 20, (8000, 2)), np.full(8000, -4.0)])
    boxes = [
        generator.uniform(
            [x - length / 2, y - width / 2, -3.9], [x + length / 2, y + width / 2, height - 4.0], (400, 3)
        )
        for x, y, length, width, height in ((8, 3, 4.2, 1.8, 1.5), (-6, 5, 0.5, 0.5, 1.7), (4, -9, 10, 2.5, 3.0))
    ]
    xyz = np.vstack([road, *boxes])
    rest = np.column_stack([np.full(len(xyz), 50.0), np.arange(len(xyz)) % 128])
    return np.hstack([xyz, rest]).astype(np.float32)
