"""The roadside lidar against the article's pipeline written plainly, in the same run and on the same frames.

    python -m benchmarks.infra_lidar

Milliseconds of processor time of one thread, so that other work on the machine matters little; still, the ratios are
what is to be read.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from dataclasses import dataclass, field, replace
from time import thread_time

import numpy as np
from sklearn.ensemble import RandomForestClassifier

from benchmarks.plain_infra_lidar import PlainPipeline, features, find_clusters, ground_and_rest
from common.geometry import rotation_between, transform
from common.sim import lidar128, roadside, world
from services.infra_lidar.buffers import Buffers
from services.infra_lidar.classes import CLASSES, LABELS
from services.infra_lidar.clustering import Clustering
from services.infra_lidar.config import (
    ARTICLE_CLUSTERING,
    ARTICLE_GROUND,
    ARTICLE_TRACKING,
    BackgroundConfig,
    InfraLidarConfig,
)
from services.infra_lidar.features import FEATURE_SETS, compute_features
from services.infra_lidar.forest import Forest
from services.infra_lidar.ground import Ground
from services.infra_lidar.pipeline import InfraLidarPipeline
from services.infra_lidar.tracking import Detections, MultiObjectTracker
from services.infra_lidar.train import flatten

FRAMES, TRAINING_SCENES = 24, 5
NAMES = tuple(name for name in FEATURE_SETS["23"] if name != "hull_point_ratio")
KIND_CLASS = {"car": 1, "bus": 2, "truck": 2, "cyclist": 3, "pedestrian": 4}
START_NS = 1_700_000_000_000_000_000


@dataclass(frozen=True)
class Frame:
    """One turn with its truth."""

    points: np.ndarray
    actor: np.ndarray
    kind: np.ndarray
    T_level_sensor: np.ndarray


def frames_of(seed: int, objects: int, count: int, columns: int = 2300, kind: str = "open") -> list[Frame]:
    """Consecutive turns of a generated street, about 180 000 returns each at 2300 columns."""
    scenario = roadside.roadside(seed, objects, kind)  # type: ignore[arg-type]
    made = []
    for k in range(count):
        t_s = 4.0 + 0.1 * k
        scan, place = lidar128.scan(scenario, t_s, columns), world.world_at(scenario, t_s).scene
        normal = np.array([-place.ground.x_slope, -place.ground.y_slope, 1.0])
        normal /= np.linalg.norm(normal)
        T = place.T_map_pole
        height = float(normal @ (T[:3, 3] - [0.0, 0.0, place.ground.height(0.0, 0.0)]))
        rotation = rotation_between(T[:3, :3].T @ normal, np.array([0.0, 0.0, 1.0]))
        points = np.column_stack([scan.xyz, scan.intensity, scan.ring]).astype(np.float32)
        level = transform(rotation, np.array([0.0, 0.0, height]))
        made.append(Frame(points, scan.actor_id, np.array(lidar128.KINDS)[scan.kind], level))
    return made


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
        now_s = thread_time()
        self.stages.setdefault(name, []).append((now_s - since_s) * 1e3)
        return now_s

    def median(self, name: str = "") -> float:
        if name:
            return float(np.median(self.stages[name]))
        return float(np.median(np.sum(list(self.stages.values()), axis=0)))

    def worst(self) -> float:
        """Of the whole frame."""
        return float(np.max(np.sum(list(self.stages.values()), axis=0)))


class ArticleByKernels:
    """The article's pipeline by our kernels, at the article's settings."""

    def __init__(self, forest: Forest) -> None:
        self._buffers = buffers = Buffers()
        self._ground = Ground(ARTICLE_GROUND, buffers)
        self._clustering = Clustering(ARTICLE_CLUSTERING, ARTICLE_GROUND.range_max_m, buffers)
        self._forest = forest
        self.begin()

    def begin(self) -> None:
        """Begin a sequence anew."""
        self.tracker = MultiObjectTracker(ARTICLE_TRACKING)
        self._stamp_ns = START_NS
        self.timed = Timed()

    def process(self, frame: Frame) -> dict[str, np.ndarray]:
        t = thread_time()
        levelled = self._ground.remove(frame.points, frame.T_level_sensor)
        t = self.timed.add("ground", t)
        found = self._clustering.cluster(levelled)
        t = self.timed.add("cluster", t)
        table = compute_features(found.points, found.offsets, np.zeros(len(found), np.float32), NAMES, self._buffers)
        t = self.timed.add("features", t)
        shares = self._forest.shares(table)
        labels = shares.argmax(axis=1)
        t = self.timed.add("forest", t)
        centres, objects = found.means, np.flatnonzero(labels)
        names = [LABELS[i] for i in labels[objects].tolist()]
        box, confidence = found.box[objects], shares[objects].max(axis=1, initial=0.0)
        self._stamp_ns += 100_000_000
        seen = Detections(centres[objects], box[:, 3:6], box[:, 6], names, confidence)
        self.tracker.step(self._stamp_ns, seen)
        self.timed.add("track", t)
        return {"centres": centres, "labels": labels}


def compare(objects: int, model: RandomForestClassifier, forest: Forest) -> None:
    """(a) Both designs at the article's settings: milliseconds, ratio, agreement."""
    frames = frames_of(7, objects, FRAMES)
    plain, ours = TimedPlain(model), ArticleByKernels(forest)
    for frame in frames:  # compiles, and buffers grow to their size
        ours.process(frame)
    ours.begin()
    plain_tracks, our_tracks, results = [], [], []
    for frame in frames:  # each on its own, so that neither finds the caches full of the other
        results.append([plain.process(_arrived(frame))])
        plain_tracks.append(np.array([t.x[:3] for t in plain.tracker.tracks if t.confirmed]).reshape(-1, 3))
    for frame, pair in zip(frames, results, strict=True):
        pair.append(ours.process(_arrived(frame)))
        known = [track.position_m for track in ours.tracker.messages() if track.state != "tentative"]
        our_tracks.append(np.array(known).reshape(-1, 3))
    matched = same_class = total = 0
    for a, b in results:
        near = _nearest(a["centres"], b["centres"])
        total += len(near)
        matched += int((near[:, 1] < 0.02).sum())
        same_class += int((a["labels"] == b["labels"][near[:, 0].astype(int)])[near[:, 1] < 0.02].sum())
    twins = np.concatenate([_nearest(a, b)[:, 1] for a, b in zip(plain_tracks, our_tracks, strict=True)])
    print(f"\n(a) article's settings, {len(frames[0].points)} points, {objects} objects, {total // FRAMES} clusters")
    for name in plain.timed.stages:
        a_ms, b_ms = plain.timed.median(name), ours.timed.median(name)
        print(f"  {name:9} plain {a_ms:8.2f} ms   ours {b_ms:7.3f} ms   {a_ms / b_ms:6.0f} x")
    a_ms, b_ms = plain.timed.median(), ours.timed.median()
    print(f"  {'total':9} plain {a_ms:8.2f} ms   ours {b_ms:7.3f} ms   {a_ms / b_ms:6.1f} x")
    print(
        f"  worst frame {ours.timed.worst():.3f} ms; "
        f"equal: clusters {matched / total:.2%}, classes {same_class / max(matched, 1):.2%}, "
        f"confirmed tracks {np.mean(twins < 0.05):.2%}"
    )


def _arrived(frame: Frame) -> Frame:
    """The frame as a receiver leaves it: just written."""
    return replace(frame, points=frame.points.copy())


class TimedPlain(PlainPipeline):
    """The plain pipeline with its stages timed."""

    def __init__(self, model: RandomForestClassifier) -> None:
        super().__init__(model)
        self.timed = Timed()

    def process(self, frame: Frame) -> dict[str, np.ndarray]:  # type: ignore[override]
        t = thread_time()
        _, rest = ground_and_rest(frame.points, frame.T_level_sensor)
        kept = np.flatnonzero(rest)
        level = frame.T_level_sensor
        xyz = frame.points[kept, :3].astype(np.float64) @ level[:3, :3].T + level[:3, 3]
        t = self.timed.add("ground", t)
        clusters = find_clusters(xyz)
        t = self.timed.add("cluster", t)
        table = np.array([features(xyz[c]) for c in clusters]).reshape(-1, len(NAMES)).astype(np.float32)
        t = self.timed.add("features", t)
        labels = self._model.classes_[self._model.predict_proba(table).argmax(axis=1)]  # type: ignore[attr-defined]
        t = self.timed.add("forest", t)
        centres = np.array([xyz[c].mean(axis=0) for c in clusters]).reshape(-1, 3)
        objects = labels != 0
        self.tracker.update(centres[objects], labels[objects])
        self.timed.add("track", t)
        return {"centres": centres, "labels": labels}


def _nearest(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(len(a), 2): index of the nearest of b, and its distance."""
    if not len(a) or not len(b):
        return np.column_stack([np.zeros(len(a)), np.full(len(a), np.inf)])
    apart = np.linalg.norm(a[:, None] - b[None], axis=2)
    return np.column_stack([apart.argmin(axis=1), apart.min(axis=1)])


def default_design(objects: int, plain_ms: float) -> None:
    """(b) Our own design, first on whole frames, then with the scene learned."""
    frames = frames_of(7, objects, 30)
    learning = BackgroundConfig(learn_s=1.5, min_frames=16, azimuth_cells=2300)
    for name, background in (("whole frames", BackgroundConfig(enabled=False)), ("scene learned", learning)):
        pipeline = InfraLidarPipeline(InfraLidarConfig(background=background))
        total_ms, shares = [], []
        for k, frame in enumerate(frames):
            points = frame.points.copy()
            t = thread_time()
            result = pipeline.process(START_NS + k * 100_000_000, points)
            total_ms.append((thread_time() - t) * 1e3)
            shares.append(own_cluster_share(frame, result.cluster_id))
        late = np.array(total_ms[-8:])
        print(
            f"  {name:14} {np.median(late):7.2f} ms ({plain_ms / np.median(late):4.0f} x plain), "
            f"worst of the last 8: {late.max():.2f}; objects with a cluster of their own {np.mean(shares[-8:]):.1%}; "
            f"known {result.background.mean():.0%}; "
            + " ".join(f"{stage} {ms:.2f}" for stage, ms in result.stage_ms.items() if ms > 0.005)
        )


def own_cluster_share(frame: Frame, cluster_id: np.ndarray) -> float:
    """Share of the objects with 20 points or more within 80 m that have a cluster mostly theirs, with half of them."""
    sizes = np.bincount(cluster_id[cluster_id >= 0], minlength=1)
    near = np.einsum("ij,ij->i", frame.points[:, :2], frame.points[:, :2]) < 80.0**2
    good = total = 0
    for actor in np.unique(frame.actor[frame.actor > 0]):
        mine = (frame.actor == actor) & near
        ids = cluster_id[mine]
        count = np.bincount(ids[ids >= 0], minlength=1)
        if mine.sum() >= 20:
            best = int(count.argmax())
            total += 1
            good += bool(count[best] >= 0.5 * mine.sum() and count[best] > 0.5 * sizes[best])
    return good / max(total, 1)


def scaling() -> None:
    """Linear in points, nearly flat in objects: our default design on whole frames, tracks included."""
    config = InfraLidarConfig(background=BackgroundConfig(enabled=False))

    def milliseconds(frames: list[Frame]) -> tuple[int, float, float]:
        pipeline, spent = InfraLidarPipeline(config), []
        for k in range(14):
            t = thread_time()
            result = pipeline.process(START_NS + k * 100_000_000, frames[k % len(frames)].points)
            spent.append((thread_time() - t) * 1e3 - result.stage_ms["calibrate"])
        late = spent[6:]
        return len(frames[0].points), float(np.median(late)), float(np.max(late))

    print("\nscaling with points (40 objects):")
    last = None
    for columns in (590, 1180, 2360, 4720, 9440):
        points, median_ms, worst_ms = milliseconds(frames_of(9, 40, 1, columns))
        growth = f"{median_ms / last:.2f} per doubling" if last else ""
        print(f"  {points:7d} points  {median_ms:7.2f} ms  worst {worst_ms:7.2f}  {growth}")
        last = median_ms
    print("scaling with objects (2300 columns):")
    first = None
    for objects in (10, 40, 160, 400):
        points, median_ms, _ = milliseconds(frames_of(9, objects, 1))
        first = first or median_ms
        print(f"  {objects:4d} objects  {points} points  {median_ms:7.2f} ms  {median_ms / first:.2f} x")


def memory() -> None:
    """Bytes that one sensor's pipeline keeps between frames."""
    pipeline = InfraLidarPipeline(InfraLidarConfig(background=BackgroundConfig(learn_s=0.3, min_frames=5)))
    frame = frames_of(7, 40, 1)[0]
    for k in range(14):
        pipeline.process(START_NS + k * 100_000_000, frame.points)
    model = pipeline.scene.background.model
    model_mb = sum(a.nbytes for a in (model.ranges, model.surface, model.structure)) / 1e6 if model else 0.0
    ground, clustering = pipeline.scene.ground, pipeline.clustering
    print(
        f"\nbuffers: {ground.buffers.nbytes / 1e6:.1f} MB of points, {ground.nbytes / 1e6:.1f} MB of polar grid, "
        f"{clustering.nbytes / 1e6:.1f} MB of cells, {model_mb:.1f} MB of background"
    )


def main() -> None:
    model, forest = train()
    for objects in (40, 160):
        compare(objects, model, forest)
        plain = TimedPlain(model)
        for frame in frames_of(7, objects, 4):
            plain.process(frame)
        print(f"(b) our own design, {objects} objects, its own calibration:")
        default_design(objects, plain.timed.median())
    scaling()
    memory()


if __name__ == "__main__":
    main()
