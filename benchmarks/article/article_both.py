"""The article's pipeline twice, with stages timed: written plainly, and by our kernels at the article's settings."""

from __future__ import annotations

from dataclasses import dataclass, field
from time import thread_time

import numpy as np
from sklearn.ensemble import RandomForestClassifier

from benchmarks.article.article_tracker import ArticleTracker
from benchmarks.article.costly_features import ARTICLE_SETS
from benchmarks.article.flat_ground import flat_surface
from benchmarks.article.neighbours import spacing_deviation
from benchmarks.article.plain_infra_lidar import PlainPipeline, Tracker, features, find_clusters, ground_and_rest
from benchmarks.article.presets import ARTICLE_CLUSTERING, ARTICLE_GROUND
from benchmarks.article.second_look import refine_clusters
from benchmarks.infra_lidar.frames import Frame, frames_of
from services.infra_lidar.classification.classes import CLASSES
from services.infra_lidar.classification.classifier import Classifier
from services.infra_lidar.classification.features import compute_features
from services.infra_lidar.classification.forest import Forest
from services.infra_lidar.clustering.boxes import ClusterPoints
from services.infra_lidar.clustering.clustering import Clustering
from services.infra_lidar.config import ClassifierConfig
from services.infra_lidar.jit import kernel
from services.infra_lidar.segmentation.ground import Ground
from services.infra_lidar.training.train import flatten

TRAINING_SCENES = 5
NAMES = tuple(name for name in ARTICLE_SETS["23"] if name != "hull_point_ratio")
SPACING = "nn_dist_std"
KIND_CLASS = {"car": 1, "bus": 2, "truck": 2, "cyclist": 3, "pedestrian": 4}
START_NS = 1_700_000_000_000_000_000


def train() -> tuple[RandomForestClassifier, Forest]:
    """One forest for both designs, at the article's settings, on clusters of other streets."""
    rows, labels = [], []
    for seed in range(TRAINING_SCENES):
        (frame,) = frames_of(100 + seed, 80, 1)
        _, rest = ground_and_rest(frame.points, frame.T_level_sensor)
        kept = np.flatnonzero(rest)
        xyz = frame.points[kept, :3] @ frame.T_level_sensor[:3, :3].T + frame.T_level_sensor[:3, 3]
        for members in find_clusters(xyz):
            names, counts = np.unique(frame.kind[kept[members]], return_counts=True)
            rows.append(features(xyz[members]))
            labels.append(KIND_CLASS.get(str(names[counts.argmax()]), 0))
    model = RandomForestClassifier(
        100, max_depth=20, min_samples_leaf=5, class_weight="balanced", random_state=42, n_jobs=1
    ).fit(np.array(rows, np.float32), labels)
    identity = np.tile(np.linspace(0.0, 1.0, 2, dtype=np.float32), (len(CLASSES), 1))
    return model, flatten(model, NAMES, identity, identity, {})


@dataclass
class Timed:
    """Milliseconds per stage and frame."""

    stages: dict[str, list[float]] = field(default_factory=dict)

    def add(self, name: str, since_s: float) -> float:
        """Book the time since ``since_s`` (thread time) under a stage; returns now."""
        now_s = thread_time()
        self.stages.setdefault(name, []).append((now_s - since_s) * 1e3)
        return now_s

    def median(self, name: str = "") -> float:
        """Milliseconds of a stage, or of a whole frame without a name."""
        if name:
            return float(np.median(self.stages[name]))
        return float(np.median(self.whole()))

    def whole(self) -> np.ndarray:
        """(frames,) of all stages together."""
        return np.sum(list(self.stages.values()), axis=0)


def article_table(found: ClusterPoints) -> np.ndarray:
    """(K, len(NAMES)) float32: the article's features, above a road at z = 0."""
    at, table = NAMES.index(SPACING), np.empty((len(found.box), len(NAMES)), np.float32)
    names, road_z_m = NAMES[:at] + NAMES[at + 1 :], np.zeros(len(found.box), np.float32)
    others = compute_features(found.points, found.offsets, road_z_m, names)
    table[:, :at], table[:, at + 1 :] = others[:, :at], others[:, at:]
    table[:, at] = spacing_deviation(found.points, found.offsets)
    return table


@kernel
def mean_points(found: ClusterPoints) -> np.ndarray:
    """(K, 3) float64, the mean of the points of each cluster (m): what the article's tracker measures."""
    mean = np.zeros((len(found.box), 3))
    for k in range(len(mean)):
        for i in range(found.offsets[k], found.offsets[k + 1]):
            for axis in range(3):
                mean[k, axis] += found.points[i, axis]
        mean[k] /= found.offsets[k + 1] - found.offsets[k]
    return mean


class ArticleByKernels:
    """The article's pipeline by our steps at the article's settings, with its own ground rule and second look."""

    def __init__(self, forest: Forest) -> None:
        self._ground = Ground(ARTICLE_GROUND, fit_surface=flat_surface)
        self._clustering = Clustering(ARTICLE_CLUSTERING, ARTICLE_GROUND.range_max_m)
        self._classifier = Classifier(ClassifierConfig(min_confidence=0.0), forest)
        self.begin()

    def begin(self) -> None:
        """Begin a sequence anew."""
        self.tracker = ArticleTracker()
        self.timed = Timed()

    def process(self, frame: Frame) -> dict[str, np.ndarray]:
        """One frame: centres (K, 3) and labels (K,) of its clusters."""
        t = thread_time()
        obstacles = self._ground.remove(frame.points, frame.T_level_sensor)
        t = self.timed.add("ground", t)
        found = refine_clusters(self._clustering.cluster(obstacles))
        t = self.timed.add("cluster", t)
        classified = self._classifier.classify(article_table(found))
        t = self.timed.add("classify", t)
        centres, objects = mean_points(found), classified.labels != 0
        self.tracker.update(centres[objects], classified.labels[objects])
        self.timed.add("track", t)
        return {"centres": centres, "labels": classified.labels}


class TimedPlain(PlainPipeline):
    """The plain pipeline with its stages timed."""

    def __init__(self, model: RandomForestClassifier) -> None:
        super().__init__(model)
        self.begin()

    def begin(self) -> None:
        """Begin a sequence anew."""
        self.tracker = Tracker()
        self.timed = Timed()

    def process(self, frame: Frame) -> dict[str, np.ndarray]:  # type: ignore[override]
        """One frame: centres (K, 3) and labels (K,) of its clusters."""
        t = thread_time()
        _, rest = ground_and_rest(frame.points, frame.T_level_sensor)
        kept = np.flatnonzero(rest)
        level = frame.T_level_sensor
        xyz = frame.points[kept, :3].astype(np.float64) @ level[:3, :3].T + level[:3, 3]
        t = self.timed.add("ground", t)
        clusters = find_clusters(xyz)
        t = self.timed.add("cluster", t)
        table = np.array([features(xyz[c]) for c in clusters]).reshape(-1, len(NAMES)).astype(np.float32)
        labels = self._model.classes_[self._model.predict_proba(table).argmax(axis=1)]  # type: ignore[attr-defined]
        t = self.timed.add("classify", t)
        centres = np.array([xyz[c].mean(axis=0) for c in clusters]).reshape(-1, 3)
        objects = labels != 0
        self.tracker.update(centres[objects], labels[objects])
        self.timed.add("track", t)
        return {"centres": centres, "labels": labels}
