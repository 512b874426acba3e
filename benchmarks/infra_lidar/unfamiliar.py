"""How the forest does where it has never been: three foreign generators, labelled real clusters and boxes, a motorway.

    python -m benchmarks.infra_lidar.unfamiliar [MODEL.npz]

Nothing of this teaches: ``foreign/`` shares no shape, pose or statistic with the training, and the recordings are used
nowhere else. Objects of 20 points or more count, as in ``accuracy``. "Error" is the expected calibration error of the
likeliest class (ten bins).
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from benchmarks.datasets.labelled_boxes import LabelledFrame, labelled_frames
from benchmarks.infra_lidar.accuracy import DATA, MIN_POINTS, ON_A_VEHICLE
from benchmarks.infra_lidar.foreign import distance_fields, meshes, superquadrics
from benchmarks.infra_lidar.motorway import ROADSIDE_MAST, EmptyRoad, revolutions
from services.infra_lidar.calibration.plane_fit import Calibrator
from services.infra_lidar.classification.classes import CLASSES, UNKNOWN, VEHICLES
from services.infra_lidar.classification.classifier import Classification, Classifier, reject_vehicles
from services.infra_lidar.classification.features import compute_features
from services.infra_lidar.clustering.boxes import ClusterPoints
from services.infra_lidar.clustering.clustering import Clustering
from services.infra_lidar.config import CalibrationConfig, ClassifierConfig, ClusteringConfig, GroundConfig
from services.infra_lidar.segmentation.ground import Ground
from services.infra_lidar.training.clusters import LabelledClusters, collect
from services.infra_lidar.training.evaluate import Evaluation, judge

SEED = 77_000
_HDL32 = {"car": "car", "pedestrian": "pedestrian", "bush": "background", "trunk": "background"}


class Found(NamedTuple):
    """One frame cut into clusters, and what they are called."""

    clusters: ClusterPoints
    called: Classification
    is_ground: np.ndarray  # (N,) bool, of every point


def find(points: np.ndarray, calibration: CalibrationConfig, classifier: Classifier) -> Found:
    """The service's steps on one frame (N, 3), nothing learned before."""
    T = Calibrator(calibration).add(points).T_level_sensor
    ground = Ground(GroundConfig())
    levelled = ground.level_only(points, T)
    obstacles = ground.remove_levelled(levelled)
    clusters = Clustering(ClusteringConfig(), GroundConfig().range_max_m).cluster(obstacles)
    road_z_m = np.asarray(ground.road_height(clusters.box[:, 0], clusters.box[:, 1]))
    called = classifier.extract_and_classify(clusters, road_z_m)
    on_drop = ground.find_drops(levelled)[ground.cells_at(clusters.box[:, 0], clusters.box[:, 1])]
    return Found(clusters, reject_vehicles(called, on_drop), obstacles.is_ground)


def foreign_sets() -> Iterator[tuple[str, LabelledClusters]]:
    """The three generators, 1,500 to 1,800 clusters each."""
    yield "superquadrics", superquadrics.clusters(SEED, 300)
    yield "distance fields", distance_fields.clusters(SEED, 1500)
    yield "meshes", meshes.clusters(SEED, 180)


def hdl32_clusters() -> LabelledClusters | None:
    """The hand-labelled clusters of an HDL-32E: metres and z up as the folder's README says."""
    folder = DATA / "labelled-clusters-hdl32"
    points: list[np.ndarray] = []
    labels: list[int] = []
    for file, name in _HDL32.items():
        if (folder / f"{file}.npz").exists():
            with np.load(folder / f"{file}.npz") as stored:
                raw, offsets = stored["xyz_raw"], stored["offsets"]
            xyz = 0.2 * np.column_stack([raw[:, 0], -raw[:, 2], raw[:, 1]])
            found = [cluster for cluster in np.split(xyz, offsets[1:-1]) if len(cluster) >= MIN_POINTS]
            points += found
            labels += [CLASSES.index(name)] * len(found)
    if not points:
        return None
    lowest = [float(cluster[:, 2].min()) for cluster in points]
    return collect(points, lowest, labels, list(range(len(points))))


def score(classifier: Classifier, clusters: LabelledClusters) -> tuple[Evaluation, float]:
    """The figures over likeliest classes, and the share of clusters that is called unknown."""
    c = clusters
    features = compute_features(c.points, c.offsets, c.ground_z_m, classifier.feature_names)
    called = classifier.classify(features)
    return judge(called.probabilities, clusters.labels), float(np.mean(called.labels == UNKNOWN))


def print_clusters(classifier: Classifier) -> None:
    """A line for each generator and one for the real clusters."""
    real = hdl32_clusters()
    sets = [*foreign_sets(), *([("real, HDL-32E", real)] if real else [])]
    for name, clusters in sets:
        result, unknown = score(classifier, clusters)
        each = ", ".join(f"{CLASSES[c]} {result.f1[c]:.3f}" for c in np.flatnonzero(result.present))
        print(
            f"  {name:16} macro F1 {result.macro_f1:.3f} ({each}), error {result.calibration_error():.3f}, "
            f"unknown {unknown:.1%}, {len(clusters)} clusters"
        )


def boxes(classifier: Classifier) -> None:
    """Real boxes: with a cluster of their own, and of those called right."""
    rows = [(frame.data_set, *row) for frame in labelled_frames(DATA) for row in _boxes_of(frame, classifier)]
    if not rows:
        print("  no labelled recordings here (SPOTTER_DATA)")
        return
    for name in [*dict.fromkeys(row[0] for row in rows), "all"]:
        own = [row for row in rows if name in (row[0], "all")]
        found = [row for row in own if row[2] is not None]
        right = sum(row[1] == row[2] for row in found)
        sure = np.array([row[3] for row in found])
        hit = np.array([row[4] for row in found])
        error = Evaluation(np.eye(2), sure, hit).calibration_error()
        print(
            f"  {name:12} {len(own):3d} boxes, own cluster {len(found) / len(own):.1%}, "
            f"of those right {right / len(found):.1%}, error {error:.3f}"
        )


def _boxes_of(frame: LabelledFrame, classifier: Classifier) -> Iterator[tuple[int, int | None, float, bool]]:
    """True class, called class (None: no cluster of its own), confidence, whether the likeliest class is right."""
    found = find(frame.points, ON_A_VEHICLE, classifier)
    cluster_id = found.clusters.cluster_id(len(frame.points))
    for k, label in enumerate(frame.labels):
        inside = frame.inside(k)
        if label not in CLASSES or inside.sum() < MIN_POINTS:
            continue
        ids = cluster_id[inside & ~found.is_ground]
        count = np.bincount(ids[ids >= 0], minlength=1)
        best, true = int(count.argmax()), CLASSES.index(label)  # type: ignore[arg-type]
        if count[best] < 0.5 * len(ids) or count[best] <= 0.5 * found.clusters.counts[best]:
            yield true, None, 0.0, False
        else:
            likeliest = int(found.called.probabilities[best].argmax())
            yield true, int(found.called.labels[best]), float(found.called.confidence[best]), likeliest == true


def motorway(classifier: Classifier) -> None:
    """False vehicles of each revolution, as ``motorway.py`` counts them."""
    frames = revolutions()
    if not frames:
        print("  no roadside recording here (SPOTTER_DATA)")
        return
    empty = EmptyRoad(Calibrator(ROADSIDE_MAST).add(frames[0]).T_level_sensor)
    false, true = [], []
    for points in frames:
        found = find(points, ROADSIDE_MAST, classifier)
        vehicles = np.flatnonzero(np.isin(found.called.labels, VEHICLES))
        rows = np.split(found.clusters.members, found.clusters.offsets[1:-1])
        false.append(sum(empty.explains(points[rows[k]]) for k in vehicles))
        true.append(len(vehicles) - false[-1])
    print(f"  false vehicles per revolution {np.mean(false):.1f} (most {max(false)}), others {np.mean(true):.1f}")


def main(model: str = "") -> None:
    """The command above."""
    classifier = Classifier(ClassifierConfig(model=model))
    print("foreign generators and labelled real clusters")
    print_clusters(classifier)
    print(f"\nlabelled real boxes of {MIN_POINTS} points or more, single frames from vehicles")
    boxes(classifier)
    print("\nmotorway from a mast, single revolutions, nothing learned")
    motorway(classifier)


if __name__ == "__main__":
    main(*sys.argv[1:])
