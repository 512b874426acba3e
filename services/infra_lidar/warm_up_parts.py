"""What is run of the kernels before the first real frame, in parts that can be compiled each by itself."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from msgspec.structs import replace

from services.infra_lidar import velodyne
from services.infra_lidar.background import MAX_RINGS, Background, BackgroundModel, locate
from services.infra_lidar.buffers import Buffers
from services.infra_lidar.classes import CLASSES
from services.infra_lidar.classifier import Classifier
from services.infra_lidar.clustering import Clustering, ClusterPoints
from services.infra_lidar.config import BackgroundConfig, InfraLidarConfig
from services.infra_lidar.features import compute_spacing, features_of, may_wait, wanted_of
from services.infra_lidar.ground import Obstacles
from services.infra_lidar.pipeline import InfraLidarPipeline
from services.infra_lidar.range_image import RangeImage
from services.infra_lidar.tracking import MultiObjectTracker, records_of
from services.infra_lidar.tracking_filter import DETECTION
from services.infra_lidar.vectors import LANES

FRAME_NS = 100_000_000
STEPS = (*range(9), 60)  # frames: to the end of learning, beyond, and until the pole is looked after again


def compile_ground(config: InfraLidarConfig) -> None:
    """Whole frames of a scene that is never learned to the end: the road, and blindness."""
    _part(endless(config), STEPS[:3])


def compile_background(config: InfraLidarConfig) -> None:
    """Beyond the end of learning, and whether people are part of the scene, until the pole is looked after again."""
    _part(config, STEPS)


def _part(config: InfraLidarConfig, steps: tuple[int, ...]) -> None:
    frame, pipeline, people = made_up_frame(), InfraLidarPipeline(config), two_people()
    scene, nobody = pipeline.scene, np.zeros(len(frame), np.float32)
    for k in steps:
        stamp_ns = (10 + k) * FRAME_NS
        parted = scene.part(stamp_ns, frame, pipeline.calibration.update(frame))
        road_z_m = scene.ground.road_below(people.box)
        scene.mark_structure(parted, people, road_z_m, np.zeros(2, np.int64))
        if not parted.sifted:
            scene.learn(stamp_ns, frame, parted, nobody)
        pipeline.blindness.judge(parted.seen, None, 0.0, "")


def endless(config: InfraLidarConfig) -> InfraLidarConfig:
    """The same, but the scene is learned for ever."""
    return replace(config, background=replace(config.background, learn_s=1e9))


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
    """Features, of a people."""
    people, wanted = two_people(), wanted_of(Classifier(config.classifier).feature_names)
    features_of(people.planar, people.offsets, people.counts, np.zeros(2, np.float32), wanted, Buffers(), False)


def compile_classes(config: InfraLidarConfig) -> None:
    """Classes, of whatever."""
    classifier = Classifier(config.classifier)
    classifier.classify(np.zeros((2, len(classifier.feature_names)), np.float32))


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
# What can be compiled by itself, the longest first
PARTS: dict[str, Callable[[InfraLidarConfig], None]] = {
    "clusters": compile_clusters,
    "tracks": compile_tracks,
    "ground": compile_ground,
    "features": compile_features,
    "classes": compile_classes,
    "packets": compile_packets,
    "background": compile_background,  # with the ground before it
}
LATER = ("background",)  # not needed before a scene has been learned


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
