"""How well the roadside lidar finds the road and keeps things apart, on generated streets and on labelled recordings.

    python -m benchmarks.infra_lidar.accuracy

Compared with the article's design (same calibration) and, on the Argoverse sweep, with Patchwork++ (pypatchworkpp).
Recordings are found through SPOTTER_DATA; a missing one is named and left out.
"""

from __future__ import annotations

import os
from collections import Counter, defaultdict
from pathlib import Path

import numpy as np

from benchmarks.article.ablation import ablation
from benchmarks.article.costly_features import ARTICLE_SETS
from benchmarks.article.flat_ground import flat_surface
from benchmarks.article.presets import ARTICLE_CLUSTERING, ARTICLE_GROUND
from benchmarks.article.second_look import refine_clusters
from benchmarks.datasets.labelled_boxes import LabelledFrame, labelled_frames
from benchmarks.infra_lidar.frames import Frame, frames_of, revolutions
from services.infra_lidar.calibration.plane_fit import Calibrator
from services.infra_lidar.classification.classes import CLASSES, LABELS
from services.infra_lidar.classification.classifier import Classifier
from services.infra_lidar.classification.features import compute_features
from services.infra_lidar.clustering.clustering import Clustering
from services.infra_lidar.config import (
    BackgroundConfig,
    CalibrationConfig,
    ClassifierConfig,
    ClusteringConfig,
    GroundConfig,
    InfraLidarConfig,
)
from services.infra_lidar.pipeline import InfraLidarPipeline
from services.infra_lidar.segmentation.ground import Ground
from services.infra_lidar.training.clusters import join_clusters
from services.infra_lidar.training.evaluate import evaluate_forest
from services.infra_lidar.training.scenes import Steps, scene_clusters
from services.infra_lidar.training.train import ForestSettings, train_forest

KINDS = ("open", "level", "facade", "trees")
BESIDE_THE_POLE = ("slope", "bus", "crowd")
CALIBRATION_SCENES, CLUSTER_SCENES = 20, 6
LEARNED_SEEDS, LEARNED_FRAMES, NEAR_M = range(40, 46), 300, 80.0
TRAINING_SEEDS, TEST_SEEDS = range(2000, 2024), range(6000, 6012)
ON_A_VEHICLE = CalibrationConfig(max_tilt_deg=10.0, height_min_m=1.0, height_max_m=3.0)
MIN_POINTS, PIECE_SHARE = 20, 0.1
ROW = {"bus": "large_vehicle", "truck": "large_vehicle"}
DATA = Path(os.environ.get("SPOTTER_DATA", Path(__file__).parents[3] / "shared" / "data"))
PATCHWORK_HEIGHT_M = 1.7


def calibration() -> None:
    """Error of the normal at the foot of the pole, one frame a scene."""
    print("calibration, degrees against the road's normal at the foot (the author's code: median 1.6 to 24)")
    for kind in KINDS + BESIDE_THE_POLE:
        errors, heights, reported, refused = [], [], [], 0
        for seed in range(CALIBRATION_SCENES):
            (frame,) = frames_of(seed, 60, 1, 1800, kind)
            found = Calibrator(CalibrationConfig()).add(frame.points)
            refused += bool(found.refused)
            if not found.refused:
                truth = frame.T_level_sensor
                cosine = np.clip(found.normal @ truth[2, :3], -1.0, 1.0)
                errors.append(np.degrees(np.arccos(cosine)))
                heights.append(abs(found.height_m - truth[2, 3]))
                reported.append(found.error_deg)
        print(
            f"  {kind:7} {CALIBRATION_SCENES} scenes: median {np.median(errors):.3f}, worst {max(errors):.3f}, "
            f"height off by at most {max(heights) * 100:.1f} cm, reported error {np.median(reported):.3f}, "
            f"refused {refused}"
        )


def streets(kinds: tuple[str, ...], objects: int) -> list[Frame]:
    """One revolution of each of some streets of every kind."""
    return [frames_of(20 + seed, objects, 1, 1800, kind)[0] for kind in kinds for seed in range(CLUSTER_SCENES)]


def article_steps() -> Steps:
    """The article's way from points to clusters, with our calibration."""
    ground = Ground(ARTICLE_GROUND, fit_surface=flat_surface)
    clustering = Clustering(ARTICLE_CLUSTERING, ARTICLE_GROUND.range_max_m)
    return Steps(CalibrationConfig(), ground, clustering, refine_clusters)


def ground_and_clusters(frames: list[Frame]) -> None:
    """Ground and clusters of both designs, with the calibration found by ourselves."""
    for name, steps in (("ours", Steps.of(InfraLidarConfig())), ("article", article_steps())):
        overlaps, good, total = [], Counter[str](), Counter[str]()
        for frame in frames:
            T = Calibrator(CalibrationConfig()).add(frame.points).T_level_sensor
            levelled = steps.ground.level_only(frame.points, T)
            obstacles = steps.ground.remove_levelled(levelled)
            inside, is_ground = levelled.cell >= 0, obstacles.is_ground
            truth = (frame.actor == -2) & inside
            overlaps.append((is_ground & truth).sum() / ((is_ground | truth) & inside).sum())
            found = steps.clustering.cluster(obstacles)
            found = steps.refine(found) if steps.refine else found
            _count_own(frame, inside, found.cluster_id(len(inside)), good, total)
        shares = ", ".join(f"{k} {good[k] / total[k]:.1%} of {total[k]}" for k in sorted(total))
        print(
            f"  {name:8} ground IoU median {np.median(overlaps):.3f}, least {min(overlaps):.3f}; own cluster: {shares}"
        )


def _count_own(
    frame: Frame, inside: np.ndarray, cluster_id: np.ndarray, good: Counter[str], total: Counter[str]
) -> None:
    """Objects of 20 points or more that have a cluster mostly theirs with at least half of those points."""
    sizes = np.bincount(cluster_id[cluster_id >= 0], minlength=1)
    for actor in np.unique(frame.actor[(frame.actor > 0) & inside]):
        mine = (frame.actor == actor) & inside
        if mine.sum() < 20:
            continue
        kind = ROW.get(str(frame.kind[mine][0]), str(frame.kind[mine][0]))
        ids = cluster_id[mine]
        count = np.bincount(ids[ids >= 0], minlength=1)
        best = int(count.argmax())
        total[kind] += 1
        good[kind] += bool(count[best] >= 0.5 * mine.sum() and count[best] > 0.5 * sizes[best])


def learned_scenes() -> None:
    """Objects with a cluster of their own once the scene is learned, and on the same frames without that."""
    names = "scene learned", "  from ranges", "whole frames"
    shares = {name: (Counter[str](), Counter[str]()) for name in names}
    known = []
    for seed in LEARNED_SEEDS:
        of_points, of_ranges = InfraLidarPipeline(InfraLidarConfig()), InfraLidarPipeline(InfraLidarConfig())
        whole = InfraLidarPipeline(InfraLidarConfig(background=BackgroundConfig(enabled=False)))
        for k, frame in enumerate(revolutions(seed, 60, LEARNED_FRAMES, 1800)):
            stamp_ns = k * 100_000_000 + 1
            results = of_points.process(stamp_ns, frame.points), of_ranges.process(stamp_ns, frame.image)
            if k < 10:
                whole.process(stamp_ns, frame.points)  # it calibrates
            if not all(result.segmentation.background_subtracted for result in results) or k % 10:
                continue
            known.append(results[0].background.mean())
            plain = whole.process(stamp_ns, frame.points).cluster_id
            clusters = results[0].cluster_id, results[1].cluster_id[frame.place], plain
            inside = np.hypot(frame.points[:, 0], frame.points[:, 1]) < NEAR_M
            for cluster_id, counted in zip(clusters, shares.values(), strict=True):
                _count_own(frame, inside, cluster_id, *counted)
    for name, (good, total) in shares.items():
        each = ", ".join(f"{k} {good[k] / total[k]:.1%} of {total[k]}" for k in sorted(total))
        print(f"  {name:14} own cluster: {each}")
    print(f"  {np.mean(known):.0%} of the returns are known")


def argoverse() -> None:
    """Precision and recall of the ground on the sweep whose points are labelled."""
    path = DATA / "labelled-argoverse2" / "log_7fab2350" / "sweep_315966265259836000.npz"
    if not path.exists():
        print("  no Argoverse sweep here (SPOTTER_DATA)")
        return
    with np.load(path) as file:
        points, truth = file["xyz"], file["is_ground"]
    T = Calibrator(CalibrationConfig()).add(points).T_level_sensor
    _score("ours", Ground(GroundConfig()).remove(points, T).is_ground, truth)
    flat = Ground(ARTICLE_GROUND, fit_surface=flat_surface)
    _score("article", flat.remove(points, T).is_ground, truth)
    try:
        import pypatchworkpp
    except ImportError:
        print("  pypatchworkpp is not installed (the bench extra)")
        return
    parameters = pypatchworkpp.Parameters()
    parameters.verbose, parameters.sensor_height, parameters.enable_RNR = False, PATCHWORK_HEIGHT_M, False
    estimator = pypatchworkpp.patchworkpp(parameters)
    lifted = np.column_stack([points - [0.0, 0.0, PATCHWORK_HEIGHT_M], np.zeros(len(points))]).astype(np.float32)
    estimator.estimateGround(lifted)  # the sweep is in the vehicle's frame, road at zero
    ground = np.zeros(len(points), bool)
    ground[estimator.getGroundIndices()] = True
    _score("Patchwork++", ground, truth)


def _score(name: str, ground: np.ndarray, truth: np.ndarray) -> None:
    hit = (ground & truth).sum()
    print(f"  {name:12} precision {hit / ground.sum():.3f}  recall {hit / truth.sum():.3f}")


def classes() -> None:
    """One forest, trained on the clusters of both designs, judges the clusters of each on other streets."""
    designs = {"ours": Steps.of(InfraLidarConfig()), "article": article_steps()}
    learnt = join_clusters([scene_clusters(TRAINING_SEEDS, steps, frames=2) for steps in designs.values()])
    tests = {name: scene_clusters(TEST_SEEDS, steps, frames=2) for name, steps in designs.items()}
    forest = train_forest(learnt, "spotter", {}, ForestSettings())
    for name, test in tests.items():
        result = evaluate_forest(forest, test)
        each = ", ".join(f"{label} {f1:.3f}" for label, f1 in zip(CLASSES, result.f1, strict=True))
        print(f"  {name:8} macro F1 {result.macro_f1:.3f} ({each}; {len(test)} clusters)")
        (_, plain), *_ = ablation(learnt, test, {"23": ARTICLE_SETS["23"]})
        print(f"  {'':8} macro F1 {plain.macro_f1:.3f} with the article's 23 features and its forest")


def boxes() -> None:
    """Labelled boxes of real data sets with MIN_POINTS points or more: one cluster each, and its class."""
    counts: dict[tuple[str, str], Counter[str]] = defaultdict(Counter)
    for frame in labelled_frames(DATA):
        _count_boxes(frame, counts)
    if not counts:
        print("  no labelled recordings here (SPOTTER_DATA)")
    for (data_set, label), n in sorted(counts.items()):
        called = ", ".join(f"{name[3:]} {count}" for name, count in n.most_common() if name.startswith("as "))
        print(f"  {data_set:12} {label:14} {n['boxes']:3d} boxes: {n['one']:3d} one cluster; called {called or '-'}")


def _count_boxes(frame: LabelledFrame, counts: dict[tuple[str, str], Counter[str]]) -> None:
    T = Calibrator(ON_A_VEHICLE).add(frame.points).T_level_sensor
    ground, classifier = Ground(GroundConfig()), Classifier(ClassifierConfig())
    obstacles = ground.remove(frame.points, T)
    found = Clustering(ClusteringConfig(), GroundConfig().range_max_m).cluster(obstacles)
    road_z_m = ground.road_height(found.box[:, 0], found.box[:, 1])
    features = compute_features(found.points, found.offsets, road_z_m, classifier.feature_names)
    called = classifier.classify(features).labels
    for k, label in enumerate(frame.labels):
        inside = frame.inside(k)
        if inside.sum() < MIN_POINTS:
            continue
        ids = found.cluster_id(len(inside))[inside & ~obstacles.is_ground]
        share = np.bincount(ids[ids >= 0], minlength=len(found.box)) / max(len(ids), 1)
        best, n = int(share.argmax()), counts[frame.data_set, label]
        own = share[best] >= 0.5 and share[best] * len(ids) > 0.5 * found.counts[best]
        n["boxes"] += 1
        n["one"] += bool(own and (share >= PIECE_SHARE).sum() == 1)
        if own:
            n[f"as {LABELS[called[best]]}"] += 1


def main() -> None:
    """The command above."""
    calibration()
    print("\ngenerated streets, each with its own calibration")
    ground_and_clusters(streets(KINDS, 60) + streets(("open",), 160))
    print("on a slope, beside a bus, in a crowd")
    ground_and_clusters(streets(BESIDE_THE_POLE, 60))
    print(f"\n{len(LEARNED_SEEDS)} streets after 20 seconds of learning, within {NEAR_M:g} m")
    learned_scenes()
    print("\nArgoverse 2 sweep, ground against the dataset's ground map")
    argoverse()
    print(f"\nlabelled boxes of {MIN_POINTS} points or more, recorded from vehicles, with the shipped forest")
    boxes()
    print("\nmacro F1 over the classes, one forest for both designs")
    classes()


if __name__ == "__main__":
    main()
