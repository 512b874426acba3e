"""Compile or load every kernel before the first real frame, and say so.

Compiled kernels are kept on disk. Without them up to four processes share the work, as many as there are processors:
the compiler itself works on one kernel at a time.
"""

from __future__ import annotations

import gc
import logging
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from itertools import product

import msgspec
import numpy as np
from numba.core import event
from numba.core.registry import cpu_target

from common.stopwatch import Stopwatch
from services.infra_lidar import velodyne
from services.infra_lidar.background import MAX_RINGS, Background, BackgroundModel, locate
from services.infra_lidar.classes import CLASSES
from services.infra_lidar.classifier import Classifier
from services.infra_lidar.clustering import Clustering, ClusterPoints
from services.infra_lidar.config import BackgroundConfig, InfraLidarConfig
from services.infra_lidar.features import compute_spacing, may_wait
from services.infra_lidar.ground import Obstacles
from services.infra_lidar.kernels_returns import beams_seen
from services.infra_lidar.pipeline import InfraLidarPipeline
from services.infra_lidar.range_image import RangeImage
from services.infra_lidar.shipped import lay_out_own
from services.infra_lidar.tracking import MultiObjectTracker, records_of
from services.infra_lidar.tracking_filter import DETECTION
from services.infra_lidar.vectors import LANES

log = logging.getLogger(__name__)

FRAME_NS = 100_000_000
STEPS = (*range(9), 60)  # frames: to the end of learning, beyond, and until the pole is looked after again

# Numba imports the larger part of itself with the first kernel: here, that is with all other imports.
cpu_target.target_context.refresh()


def warm_up(config: InfraLidarConfig, tell: Callable[[str], None]) -> float:
    """Run a small made-up frame through a pipeline of its own; returns the milliseconds it took."""

    def say(text: str) -> None:
        log.info(text)
        tell(text)

    watch = Stopwatch()
    background = msgspec.structs.replace(config.background, learn_s=0.1, min_frames=5, azimuth_cells=90)
    calibration = msgspec.structs.replace(config.calibration, frames=1, hypotheses=16)
    small = msgspec.structs.replace(config, calibration=calibration, background=background, T_map_sensor=())
    lay_out_own()
    with _collecting_seldom():
        if _compiled_before():
            say("loading kernels")
        else:
            say("compiling kernels: on the first start on this machine, about half a minute")
            _compile_together(small)
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
    """Whether the smallest kernel came from the disk."""
    beams_seen(np.zeros((1, 2), np.float32)[:, 0], np.zeros(256, bool))
    return not beams_seen.stats.cache_misses  # type: ignore[attr-defined]


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


def _compile_together(config: InfraLidarConfig) -> None:
    """Every process compiles its parts, this one those of the first."""
    own, *others = shared_out(len(os.sched_getaffinity(0)))
    words = [sys.executable, "-m", __name__]
    with ExitStack() as running:
        helpers = [running.enter_context(subprocess.Popen([*words, *names], stdin=subprocess.PIPE)) for names in others]
        for helper in helpers:
            assert helper.stdin is not None
            helper.stdin.write(msgspec.json.encode(config))
            helper.stdin.close()
        for name in own:
            PARTS[name](config)
        for helper in helpers:
            if helper.wait() != 0:  # then this process compiles those, too
                log.warning("another compiling process ended with exit code %d", helper.returncode)


def shared_out(processors: int) -> list[list[str]]:
    """The names of ``PARTS`` for each process, so that the last is ready as soon as can be. The first is this one."""
    processes = range(max(1, min(processors, len(PARTS))))

    def last_ready_s(dealt: tuple[int, ...]) -> float:
        busy_s = [IMPORTS_S if process else 0.0 for process in processes]
        for process, seconds in zip(dealt, SECONDS.values(), strict=True):
            busy_s[process] += seconds
        return max(busy_s)

    dealt = min(product(processes, repeat=len(PARTS)), key=last_ready_s)
    return [[name for name, process in zip(SECONDS, dealt, strict=True) if process == k] for k in processes]


def compile_scene(config: InfraLidarConfig) -> None:
    """Ground and background, and whether people are part of it, until the pole is looked after again; and blindness."""
    frame, pipeline, people = made_up_frame(), InfraLidarPipeline(config), two_people()
    scene, nobody = pipeline.scene, np.zeros(len(frame), np.float32)
    for k in STEPS:
        stamp_ns = (10 + k) * FRAME_NS
        parted = scene.part(stamp_ns, frame, pipeline.calibration.update(frame))
        road_z_m = scene.ground.road_below(people.box)
        scene.mark_structure(parted, people, road_z_m, np.zeros(2, np.int64))
        if not parted.sifted:
            scene.learn(stamp_ns, frame, parted, nobody)
        pipeline.blindness.judge(parted.seen, None, 0.0, "")


def compile_tracks(config: InfraLidarConfig) -> None:
    """Tracks of two people side by side, then of one of them."""
    tracker = MultiObjectTracker(config.tracking)
    follow_people(tracker)
    tracker.forget(np.array([True]))


def follow_people(tracker: MultiObjectTracker) -> None:
    """Two people side by side, who then stand so close that they are one cluster, which is cut."""
    two = np.array([[9.0, 0.0, 0.9, 0.5, 0.5, 1.7, 1.57, 0.0], [9.0, 0.8, 0.9, 0.5, 0.5, 1.7, 1.57, 0.0]], np.float32)
    one = np.array([[9.0, 0.4, 0.9, 1.3, 0.5, 1.7, 1.57, 0.0]], np.float32)
    for k, box in enumerate((*[two] * 12, one)):
        people = np.zeros((len(box), len(CLASSES)), np.float32)
        people[:, CLASSES.index("pedestrian")] = 1.0
        labels, sure = people.argmax(axis=1), np.full(len(box), 0.9, np.float32)
        made = np.empty(len(box), DETECTION)
        seen = records_of(box, labels, sure, np.full(len(box), 50, np.int32), people, np.eye(4), made)
        tracker.step((10 + k) * FRAME_NS, seen)
        tracker.told()


def compile_clusters(config: InfraLidarConfig) -> None:
    """Clusters, of a people."""
    xyz = two_people().planar
    n = xyz.shape[1]
    frame = Obstacles(np.zeros(n, bool), np.arange(n, dtype=np.int32), np.concatenate((xyz, xyz[2:])))
    Clustering(config.clustering, config.ground.range_max_m).cluster(frame)


def compile_features(config: InfraLidarConfig) -> None:
    """Features and classes, of a people."""
    know_people(Classifier(config.classifier))


def know_people(classifier: Classifier) -> None:
    """Two people, and how evenly their points are spaced, if a class can hang on that: theirs may not."""
    people, road_z_m = two_people(), np.zeros(2, np.float32)
    classifier.recognise(people.planar, people.offsets, road_z_m, counts=people.counts)
    if may_wait(classifier.feature_names):
        compute_spacing(people.planar, people.offsets, np.arange(2))


def compile_packets(config: InfraLidarConfig) -> None:
    """What decodes the packets of a sensor that sends while we begin; a recording waits."""
    scheme = config.source.partition(":")[0]
    if scheme in PACKET_KERNELS:
        PACKET_KERNELS[scheme]()


def compile_images() -> None:
    """What is done with range images."""
    none, columns = np.empty(0, np.float32), 90
    image = RangeImage(
        np.empty((0, LANES), np.float32), np.empty((0, LANES), np.uint8), none, none, np.empty(0, np.uint8),
        np.zeros((7, LANES), np.float32),
    )  # fmt: skip
    cell, squared = np.empty((2, LANES), np.int32)
    locate(image, columns, MAX_RINGS, cell, squared.view(np.float32))
    nothing = BackgroundModel(
        np.zeros((2, columns * MAX_RINGS), np.int32), columns, MAX_RINGS, 0.0, np.zeros((1, 3), np.float32)
    )
    Background(BackgroundConfig(), stored=nothing).recognise(image)
    assert len(image.points) == len(image.sample(1)) == 0


def compile_velodyne() -> None:
    """The same, and what decodes the packets of a VLS-128."""
    velodyne.decode_nothing()
    compile_images()


def two_people() -> ClusterPoints:
    """Two clusters of 400 points."""
    low, high, n = np.array([8.0, 0.0, 0.2]), np.array([8.5, 0.5, 1.7]), 800
    planar = np.empty(3 * n + LANES, np.float32)[: 3 * n].reshape(3, n)
    planar[:] = np.random.default_rng(7).uniform(low, high, (n, 3)).T
    box = np.array([[*(low + high) / 2, *(high - low), 0.0, low[2]]] * 2, np.float32)
    offsets = np.array([0, n // 2, n], np.int32)
    return ClusterPoints(planar, offsets, np.arange(n, dtype=np.int32), offsets, np.diff(offsets), box)


PACKET_KERNELS = {"velodyne": compile_velodyne, "ouster": compile_images}
# What can be compiled by itself, and how long that takes, roughly.
PARTS: dict[str, Callable[[InfraLidarConfig], None]] = {
    "clusters": compile_clusters,
    "tracks": compile_tracks,
    "scene": compile_scene,
    "features": compile_features,
    "packets": compile_packets,
}
SECONDS = {"clusters": 8.0, "tracks": 6.5, "scene": 5.0, "features": 3.5, "packets": 0.5}
IMPORTS_S = 1.0  # before another process can begin


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
        wanted = msgspec.json.decode(sys.stdin.buffer.read(), type=InfraLidarConfig)
        for part in sys.argv[1:]:
            PARTS[part](wanted)
