"""Compile or load every kernel before the first real frame, and say so.

Compiled kernels are kept on disk. Without them a second process compiles those of the later stages meanwhile: the
compiler itself works on one at a time.
"""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from collections.abc import Callable

import msgspec
import numpy as np

from common.stopwatch import Stopwatch
from services.infra_lidar.classifier import Classifier
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.features import compute_features
from services.infra_lidar.kernels_ground import beams_seen
from services.infra_lidar.pipeline import InfraLidarPipeline
from services.infra_lidar.tracking import Detections, MultiObjectTracker

log = logging.getLogger(__name__)

FRAME_NS = 100_000_000


def warm_up(config: InfraLidarConfig, tell: Callable[[str], None]) -> float:
    """Run a small made-up frame through a pipeline of its own; returns the milliseconds it took."""
    watch = Stopwatch()
    background = msgspec.structs.replace(config.background, learn_s=0.1, min_frames=5, azimuth_cells=90)
    calibration = msgspec.structs.replace(config.calibration, frames=1, hypotheses=16)
    small = msgspec.structs.replace(config, calibration=calibration, background=background, T_map_sensor=())
    frame = made_up_frame()
    if _compiled_before():
        tell("loading kernels")
    else:
        tell("compiling kernels: on the first start on this machine, about 20 s")
        _compile_by_two(small, frame)
    pipeline = InfraLidarPipeline(small)
    for k in range(9):  # to the end of learning and beyond
        pipeline.process((10 + k) * FRAME_NS, frame)
    watch.lap("warm-up")
    log.info("kernels ready after %.1f s", watch.stage_ms["warm-up"] / 1e3)
    return watch.stage_ms["warm-up"]


def _compiled_before() -> bool:
    """Whether the smallest kernel came from the disk."""
    beams_seen(np.zeros(1, np.float32), np.zeros(256, bool))
    return not beams_seen.stats.cache_misses  # type: ignore[attr-defined]


def _compile_by_two(config: InfraLidarConfig, frame: np.ndarray) -> None:
    """Early stages in this process, late ones in another, where there is a processor for it."""
    if len(os.sched_getaffinity(0)) < 2:
        return
    with subprocess.Popen([sys.executable, "-m", __name__]) as other:
        compile_early(config, frame)
        if other.wait() != 0:  # then this process compiles those, too
            log.warning("the second compiling process ended with exit code %d", other.returncode)


def compile_early(config: InfraLidarConfig, frame: np.ndarray) -> None:
    """Ground, clusters and background."""
    pipeline = InfraLidarPipeline(config)
    for k in range(9):
        stamp_ns = (10 + k) * FRAME_NS
        parted = pipeline.scene.part(stamp_ns, frame, pipeline.calibration.update(frame))
        pipeline.clustering.cluster(parted.frame)
        pipeline.scene.learn(stamp_ns, frame, parted, np.zeros(len(frame), bool))


def compile_late(config: InfraLidarConfig) -> None:
    """Features, classes and tracks, of two people side by side."""
    generator = np.random.default_rng(7)
    points = generator.uniform([0, 0, 0], [0.5, 0.5, 1.7], (200, 3)).astype(np.float32)
    classifier = Classifier(config.classifier)
    features = compute_features(points, np.array([0, 100, 200]), np.zeros(2), classifier.feature_names)
    _, confidence, probabilities = classifier.classify(features)
    seen = Detections(
        position_m=np.array([[9.0, 0.0, 0.9], [9.0, 3.0, 0.9]]), size_m=np.full((2, 3), [0.5, 0.5, 1.7]),
        yaw_rad=np.zeros(2), labels=["pedestrian"] * 2, confidence=confidence, probabilities=probabilities,
    )  # fmt: skip
    tracker = MultiObjectTracker(config.tracking)
    for k in range(5):
        tracker.update((10 + k) * FRAME_NS, seen)


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


if __name__ == "__main__":
    compile_late(InfraLidarConfig())
