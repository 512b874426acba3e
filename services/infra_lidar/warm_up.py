"""Compile or load every kernel before the first real frame, and say so.

Compiled kernels are kept on disk. Without them a second process compiles half of them meanwhile: the compiler itself
works on one at a time.
"""

from __future__ import annotations

import gc
import logging
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import msgspec
import numpy as np
from numba.core.registry import cpu_target

from common.stopwatch import Stopwatch
from services.infra_lidar.classifier import Classifier
from services.infra_lidar.clustering import Clustering
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.features import compute_features
from services.infra_lidar.ground import Levelled
from services.infra_lidar.kernels_ground import beams_seen
from services.infra_lidar.pipeline import InfraLidarPipeline
from services.infra_lidar.tracking import Detections, MultiObjectTracker

log = logging.getLogger(__name__)

FRAME_NS = 100_000_000

# Numba imports the larger part of itself with the first kernel: here, that is with all other imports.
cpu_target.target_context.refresh()


def warm_up(config: InfraLidarConfig, tell: Callable[[str], None]) -> float:
    """Run a small made-up frame through a pipeline of its own; returns the milliseconds it took."""
    watch = Stopwatch()
    background = msgspec.structs.replace(config.background, learn_s=0.1, min_frames=5, azimuth_cells=90)
    calibration = msgspec.structs.replace(config.calibration, frames=1, hypotheses=16)
    small = msgspec.structs.replace(config, calibration=calibration, background=background, T_map_sensor=())
    frame = made_up_frame()
    with _collecting_seldom():
        if _compiled_before():
            tell("loading kernels")
        else:
            tell("compiling kernels: on the first start on this machine, about half a minute")
            _compile_by_two(small)
        pipeline = InfraLidarPipeline(small)
        for k in (*range(9), 60):  # to the end of learning, beyond, and until the pole is looked after again
            pipeline.process((10 + k) * FRAME_NS, frame)
        follow_people(pipeline.tracker)
    watch.lap("warm-up")
    log.info("kernels ready after %.1f s", watch.stage_ms["warm-up"] / 1e3)
    return watch.stage_ms["warm-up"]


def _compiled_before() -> bool:
    """Whether the smallest kernel came from the disk."""
    beams_seen(np.zeros((1, 2), np.float32)[:, 0], np.zeros(256, bool))
    return not beams_seen.stats.cache_misses  # type: ignore[attr-defined]


def _compile_by_two(config: InfraLidarConfig) -> None:
    """Half of the kernels in this process, half in another one, where there is a processor for it."""
    if len(os.sched_getaffinity(0)) < 2:
        return
    with subprocess.Popen([sys.executable, "-m", __name__], stdin=subprocess.PIPE) as other:
        assert other.stdin is not None
        other.stdin.write(msgspec.json.encode(config))
        other.stdin.close()
        compile_clusters(config)
        if other.wait() != 0:  # then this process compiles those, too
            log.warning("the second compiling process ended with exit code %d", other.returncode)


def compile_scene_and_tracks(config: InfraLidarConfig, frame: np.ndarray) -> None:
    """Ground and background, then tracks of two people side by side."""
    pipeline = InfraLidarPipeline(config)
    nobody = np.zeros(len(frame), bool)
    for k in range(9):
        stamp_ns = (10 + k) * FRAME_NS
        parted = pipeline.scene.part(stamp_ns, frame, pipeline.calibration.update(frame))
        pipeline.scene.learn(stamp_ns, frame, parted, nobody)
    follow_people(pipeline.tracker)


def follow_people(tracker: MultiObjectTracker) -> None:
    """Two people side by side, who then stand so close that they are one cluster, which is cut."""
    two = np.array([[9.0, 0.0, 0.9], [9.0, 0.8, 0.9]]), np.array([[0.5, 0.5, 1.7], [0.5, 0.5, 1.7]])
    one = np.array([[9.0, 0.4, 0.9]]), np.array([[1.3, 0.5, 1.7]])
    for k, (position_m, size_m) in enumerate((*[two] * 12, one)):
        count = len(position_m)
        seen = Detections(
            position_m=position_m, size_m=size_m, yaw_rad=np.full(count, 0.5 * np.pi), labels=["pedestrian"] * count,
            confidence=np.full(count, 0.9), points=np.full(count, 50),
        )  # fmt: skip
        tracker.update((10 + k) * FRAME_NS, seen)


def compile_clusters(config: InfraLidarConfig) -> None:
    """Clusters, features and classes, of a person."""
    n, generator = 800, np.random.default_rng(7)
    xyz = generator.uniform([8.0, 0.0, 0.2], [8.5, 0.5, 1.7], (n, 3)).astype(np.float32).T.copy()
    frame = Levelled(
        x=xyz[0], y=xyz[1], z=xyz[2], cell=np.zeros(n, np.int16), ground=np.zeros(n, bool),
        rest=np.arange(n, dtype=np.int32), points=np.concatenate((xyz, xyz[2:])),
    )  # fmt: skip
    found = Clustering(config.clustering, config.ground.range_max_m).cluster(frame)
    classifier = Classifier(config.classifier)
    features = compute_features(found.points, found.offsets, np.zeros(len(found)), classifier.feature_names)
    classifier.classify(features)


@contextmanager
def _collecting_seldom() -> Iterator[None]:
    """The compiler makes millions of small objects and keeps most: to look for garbage among them costs a sixth."""
    before = gc.get_threshold()
    gc.set_threshold(200_000, 20, 100)
    try:
        yield
    finally:
        gc.set_threshold(*before)


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
    with _collecting_seldom():
        compile_scene_and_tracks(msgspec.json.decode(sys.stdin.buffer.read(), type=InfraLidarConfig), made_up_frame())
