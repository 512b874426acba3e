"""Compile or load every kernel before the first real frame, with one made-up scene.

    python -m services.infra_lidar.warm_up      # ahead of the first start, also for the simulated sensor

Compiled kernels are kept on disk, see ``jit.py``. Numba compiles one kernel at a time, so the first start of all has
a second process compile a part of them.
"""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import numpy as np
from msgspec.structs import replace

from common.stopwatch import Stopwatch
from services.infra_lidar.calibration.monitor import CalibrationMonitor
from services.infra_lidar.classification.classifier import Classifier
from services.infra_lidar.classification.features import compute_features
from services.infra_lidar.clustering.clustering import Clustering
from services.infra_lidar.config import CalibrationConfig, InfraLidarConfig
from services.infra_lidar.input.models import KINDS, compile_decoder
from services.infra_lidar.input.range_image import RangeImage, Returns
from services.infra_lidar.jit import CACHE, COMPLETE, KEPT
from services.infra_lidar.pipeline import InfraLidarPipeline
from services.infra_lidar.segmentation.ground import Obstacles
from services.infra_lidar.segmentation.scene import Scene
from services.infra_lidar.tracking import Detections, MultiObjectTracker

log = logging.getLogger(__name__)

DONE = CACHE / COMPLETE
CLUSTERS = "clusters"  # the argument of the second process
FRAMES = (*range(9), 60)  # at 0.1 s each: learning, its end, beyond, and the next check of the calibration
PERIOD_NS = 100_000_000
HEIGHT_M = 4.0  # of the made-up sensor above its road
BOXES = ((8, 3, 4.2, 1.8, 1.5), (-6, 5, 0.5, 0.5, 1.7), (4, -9, 10, 2.5, 3.0))  # x, y, length, width, height (m)
POINTS = 400  # in each


def warm_up(config: InfraLidarConfig, report: Callable[[str], None]) -> float:
    """Run a made-up scene through the pipeline until it has learned the background; returns the milliseconds it took.

    ``report`` is called with a line of text about the progress, which is also logged.
    """
    doing = "loading kernels" if DONE.exists() else "compiling kernels: once on this machine, about a minute"
    report(doing)
    log.info(doing)
    watch, image = Stopwatch(), made_up_revolution()
    calibration = CalibrationConfig(frames=1, hypotheses=16)  # the made-up sensor stands level, the real one may not
    background = replace(config.background, learn_s=0.1, min_frames=5)
    kinds = kinds_that_may_come(config.source)
    config = replace(config, calibration=calibration, background=background, T_map_sensor=())
    with second_compiler() as beside:
        if beside:  # it compiles the clustering; compile the rest here
            for returns in (image.points, image):
                segment(config, returns)
            classify(config)
        for kind in kinds:
            compile_decoder(kind)
        track_two_people(MultiObjectTracker(config.tracking))
    for returns in (image.points, image):
        pipeline = InfraLidarPipeline(config)
        for k in FRAMES:
            pipeline.process((10 + k) * PERIOD_NS, returns)
    if KEPT:
        with suppress(OSError):  # the disk has become full: the next start compiles what is missing
            DONE.touch()
    watch.lap("warm-up")
    log.info("kernels ready after %.1f s", watch.stage_ms["warm-up"] / 1e3)
    return watch.stage_ms["warm-up"]


@contextmanager
def second_compiler() -> Iterator[bool]:
    """Compile clustering in a second process if a second core is free; yields True if it runs.

    Clustering takes as long to compile as all the rest. If the second process fails, this one compiles it later.
    """
    if DONE.exists() or not KEPT or len(os.sched_getaffinity(0)) < 2:
        yield False
        return
    command = [sys.executable, "-m", "services.infra_lidar.warm_up", CLUSTERS]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield True
        process.wait()
    finally:
        process.kill()


def kinds_that_may_come(source: str) -> tuple[str, ...]:
    """Of live packets, all of them without a source. Recordings lose nothing while their first packet waits."""
    scheme = source.partition(":")[0]
    if scheme in ("", "ros2"):
        return tuple(KINDS)
    return (scheme,) if scheme in KINDS else ()


def made_up_revolution() -> RangeImage:
    """A flat road with three boxes on it, seen by 64 beams in 720 directions (ray casting by Kay and Kajiya 1986)."""
    heading, elevation = (np.arange(720) + 0.5) * np.radians(0.5), np.radians(np.linspace(-50.0, -4.0, 64))
    flat, up, none = np.cos(elevation), np.sin(elevation), np.zeros(64)
    ray = np.stack(np.broadcast_arrays(np.outer(np.cos(heading), flat), np.outer(np.sin(heading), flat), up), axis=-1)
    range_m = -HEIGHT_M / ray[..., 2]
    for x, y, length, width, height in BOXES:
        low = np.array([x - length / 2, y - width / 2, -HEIGHT_M])
        enter, leave = np.sort([low / ray, (low + np.array([length, width, height])) / ray], axis=0)
        enter_m, leave_m = enter.max(axis=-1), leave.min(axis=-1)
        range_m = np.where((enter_m > 0.0) & (enter_m < leave_m), np.minimum(range_m, enter_m), range_m)
    range_m += np.random.default_rng(7).normal(0.0, 0.01, range_m.shape)
    cos, sin = np.cos(heading).astype(np.float32), np.sin(heading).astype(np.float32)
    beams = np.stack([flat, none, up, none, none, none, np.arange(64)]).astype(np.float32)
    intensity, bank = np.full(range_m.shape, 50, np.uint8), np.zeros(720, np.uint8)
    return RangeImage(range_m.astype(np.float32), intensity, cos, sin, bank, beams)


def segment(config: InfraLidarConfig, returns: Returns) -> None:
    """Calibrate, learn the background and subtract it."""
    monitor, nobody = CalibrationMonitor(config.calibration, None), np.zeros(len(returns), np.float32)
    scene = Scene(config, monitor, None)
    for k in FRAMES:
        segmentation = scene.segment((10 + k) * PERIOD_NS, returns, monitor.update(returns))
        scene.learn((10 + k) * PERIOD_NS, returns, segmentation, nobody, nobody)


def points_in_boxes() -> np.ndarray:
    """(M, 3) float32 points inside the boxes, POINTS of each in turn, level frame."""
    rng = np.random.default_rng(7)
    inside = [
        rng.uniform((x - length / 2, y - width / 2, 0.0), (x + length / 2, y + width / 2, height), (POINTS, 3))
        for x, y, length, width, height in BOXES
    ]
    return np.concatenate(inside).astype(np.float32)


def cluster(config: InfraLidarConfig) -> None:
    """Cluster points inside the boxes."""
    xyz = points_in_boxes()
    obstacles = Obstacles(np.column_stack((xyz, xyz[:, 2])), np.arange(len(xyz), dtype=np.int32), np.empty(0, bool))
    Clustering(config.clustering, config.ground.range_max_m).cluster(obstacles)


def classify(config: InfraLidarConfig) -> None:
    """Classify what lies inside the boxes."""
    classifier = Classifier(config.classifier)
    offsets, road_z_m = np.arange(len(BOXES) + 1) * POINTS, np.zeros(len(BOXES), np.float32)
    classifier.classify(compute_features(points_in_boxes(), offsets, road_z_m, classifier.feature_names))


def track_two_people(tracker: MultiObjectTracker) -> None:
    """Two people side by side, then so close that they are one cluster, which the tracker divides."""
    for k, (y_m, width_m) in enumerate([([0.0, 0.8], 0.5)] * 12 + [([0.4], 1.3)]):
        n = len(y_m)
        centre_m, size_m = np.array([[9.0, y, 0.9] for y in y_m]), np.tile([width_m, 0.5, 1.7], (n, 1))
        people = Detections(centre_m, size_m, np.full(n, 1.57), ["pedestrian"] * n, np.full(n, 0.9), np.full(n, 50))
        tracker.update((10 + k) * PERIOD_NS, people)


def main() -> None:
    """Compile all kernels for this processor, and those of the simulated sensor; or ``CLUSTERS`` only."""
    if CLUSTERS in sys.argv[1:]:
        cluster(InfraLidarConfig())
        return
    from spotter_sim import lidar128

    logging.basicConfig(level=logging.INFO, format="%(message)s")
    warm_up(InfraLidarConfig(), lambda text: None)
    lidar128.scan("crossing", 0.0)


if __name__ == "__main__":
    main()
