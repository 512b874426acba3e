"""What the votes of a track are worth: the class of each cluster by itself against that of its track.

    python -m benchmarks.infra_lidar.voting

Streets of our own that the forest has not seen, through the whole pipeline; and single bodies of a foreign hand
(``foreign/superquadrics.py``) that pass the pole, cluster by cluster through forest and tracker. Only clusters with a
confirmed track count. No labelled recording is long enough: of Argoverse 2 there are two sweeps in a row, a track is
confirmed in the third.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from typing import NamedTuple

import msgspec
import numpy as np

from benchmarks.infra_lidar.foreign import superquadrics
from services.infra_lidar.classification.classes import BACKGROUND, CLASSES, UNKNOWN
from services.infra_lidar.classification.classifier import Classifier
from services.infra_lidar.classification.features import compute_features
from services.infra_lidar.clustering.boxes import fit_box
from services.infra_lidar.config import ClassifierConfig, InfraLidarConfig
from services.infra_lidar.pipeline import InfraLidarPipeline
from services.infra_lidar.result import FrameResult
from services.infra_lidar.tracking import Detections, MultiObjectTracker
from services.infra_lidar.tracking.config import TrackingConfig
from spotter_sim.lidar128 import Scan, scan
from spotter_sim.roadside import roadside
from spotter_sim.solids import KINDS

SEED, STREETS, FRAMES, PERIOD_NS = 9100, 2, 25, 100_000_000
BODIES_PER_CLASS, PASSING_FRAMES = 12, 25
PURE, MIN_POINTS = 0.7, 20
CLASS_OF = {"pedestrian": "pedestrian", "cyclist": "cyclist", "car": "car", "bus": "large_vehicle"} | {
    "truck": "large_vehicle"
}
_CLASS_OF_KIND = np.array([CLASSES.index(CLASS_OF.get(kind, "background")) for kind in KINDS])
AGES_S, AGES = (1.0, 2.0), ("track under 1 s", "1 to 2 s", "older")


class Said(NamedTuple):
    """One cluster of a confirmed track: what it is, what forest and track call it, and the age of the track (s)."""

    true: int
    cluster: int
    track: int
    age_s: float


def street(seed: int) -> Iterator[Said]:
    """Every pure cluster of a road user with a confirmed track, on one of our own streets."""
    scenario = roadside(seed, 80, "open")
    pose = tuple(float(v) for v in scenario.scene.T_map_pole.ravel())
    pipeline = InfraLidarPipeline(msgspec.structs.replace(InfraLidarConfig(), T_map_sensor=pose))
    for number in range(FRAMES):
        view = scan(scenario, 1.0 + 1e-9 * number * PERIOD_NS)
        points = np.column_stack((view.xyz, view.intensity, view.ring)).astype(np.float32)
        yield from _said(pipeline.process(10**18 + number * PERIOD_NS, points), pipeline.tracker.matches, view)


def _said(result: FrameResult, cluster_of: dict[int, int], view: Scan) -> Iterator[Said]:
    clusters, table = result.clusters, result.table
    for row in np.flatnonzero(table.state == 1):
        k = cluster_of[int(table.track_id[row])]
        members = clusters.members[clusters.offsets[k] : clusters.offsets[k + 1]]
        owners, first, count = np.unique(view.actor_id[members], return_index=True, return_counts=True)
        best = int(count.argmax())
        if owners[best] >= 0 and len(members) >= MIN_POINTS and count[best] >= PURE * len(members):
            true = int(_CLASS_OF_KIND[view.kind[members[first[best]]]])
            yield Said(true, int(clusters.classes[k]), int(table.label[row]), float(table.age_s[row]))


def passing(classifier: Classifier, label: int, bodies: list[list[np.ndarray]]) -> Iterator[Said]:
    """The same of foreign bodies; each is a list of clusters (n, 3), a revolution apart."""
    for clusters in bodies:
        tracker = MultiObjectTracker(TrackingConfig())
        for number, points in enumerate(clusters):
            offsets, box = np.array([0, len(points)]), np.zeros(8, np.float32)
            fit_box(np.column_stack((points, points[:, 2])).astype(np.float32), box)
            called = classifier.classify(compute_features(points, offsets, np.zeros(1), classifier.feature_names))
            tracker.step(10**18 + number * PERIOD_NS, _detection(box, called.labels, called, len(points)))
            table = tracker.snapshot()
            for row in np.flatnonzero(table.state == 1):
                yield Said(label, int(called.labels[0]), int(table.label[row]), float(table.age_s[row]))


def _detection(box, labels, called, points) -> np.ndarray:  # type: ignore[no-untyped-def]
    return Detections(
        position_m=box[None, :3], size_m=box[None, 3:6], yaw_rad=box[6:7], labels=labels, confidence=called.confidence,
        points=np.array([points]), probabilities=called.probabilities,
    ).records()  # fmt: skip


def print_table(name: str, said: list[Said]) -> None:
    """Share called right by cluster and by track, each class and each age; how often neither, and unknown."""
    print(f"\n{name}: {len(said)} clusters of confirmed tracks")
    print(f"{'':<16}{'clusters':>9}{'cluster':>9}{'track':>9}{'worse':>7}{'better':>8}")
    rows: dict[str, list[Said]] = defaultdict(list)
    for one in said:
        rows[CLASSES[one.true]].append(one)
        rows[AGES[int(np.searchsorted(AGES_S, one.age_s, side="right"))]].append(one)
        rows["all"].append(one)
    for key in [*CLASSES[1:], *AGES, "all"]:
        if rows[key]:
            _print_row(key, np.array(rows[key]))
    for way, column in (("cluster", 1), ("track", 2)):
        called = np.array(said)[:, column]
        print(f"  {way}: unknown {np.mean(called == UNKNOWN):.1%}, background {np.mean(called == BACKGROUND):.1%}")


def _print_row(name: str, said: np.ndarray) -> None:
    cluster, track = said[:, 1] == said[:, 0], said[:, 2] == said[:, 0]
    print(
        f"{name:<16}{len(said):9d}{np.mean(cluster):9.1%}{np.mean(track):9.1%}"
        f"{np.mean(cluster & ~track):7.1%}{np.mean(~cluster & track):8.1%}"
    )


def main() -> None:
    """The command above."""
    print_table("own streets", [one for seed in range(SEED, SEED + STREETS) for one in street(seed)])
    classifier = Classifier(ClassifierConfig())
    foreign: list[Said] = []
    for label in range(1, len(CLASSES)):
        foreign += passing(classifier, label, superquadrics.passing(SEED, label, BODIES_PER_CLASS, PASSING_FRAMES))
    print_table("foreign bodies that pass", foreign)


if __name__ == "__main__":
    main()
