"""How well the roadside lidar finds the road and keeps things apart, on generated streets and on labelled recordings.

    python -m benchmarks.infra_lidar_accuracy

Beside our design stands the article's (same calibration), and on the Argoverse sweep Patchwork++ (pypatchworkpp).
"""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path

import numpy as np

from benchmarks.infra_lidar import Frame, frames_of
from services.infra_lidar.calibration import Calibrator
from services.infra_lidar.clustering import Clustering
from services.infra_lidar.config import (
    ARTICLE_CLUSTERING,
    ARTICLE_GROUND,
    CalibrationConfig,
    ClusteringConfig,
    GroundConfig,
)
from services.infra_lidar.ground import Ground

KINDS = ("open", "level", "facade", "trees")
CALIBRATION_SCENES, CLUSTER_SCENES = 20, 6
ROW = {"bus": "large_vehicle", "truck": "large_vehicle"}
DATA = Path(os.environ.get("SPOTTER_DATA", Path(__file__).parents[2] / "shared" / "data"))
PATCHWORK_HEIGHT_M = 1.7


def calibration() -> None:
    """Error of the normal at the foot of the pole, one frame a scene."""
    print("calibration, degrees against the road's normal at the foot (the author's code: median 1.6 to 24)")
    for kind in KINDS:
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


def streets() -> None:
    """Ground and clusters, with the calibration found by ourselves."""
    scenes = [(kind, 20 + seed, 60) for kind in KINDS for seed in range(CLUSTER_SCENES)]
    frames = [frames_of(seed, objects, 1, 1800, kind)[0] for kind, seed, objects in scenes]
    frames += [frames_of(20 + seed, 160, 1, 1800)[0] for seed in range(CLUSTER_SCENES)]
    for name, ground, clustering in (
        ("ours", GroundConfig(), ClusteringConfig()),
        ("article", ARTICLE_GROUND, ARTICLE_CLUSTERING),
    ):
        remove, group = Ground(ground), Clustering(clustering, ground.range_max_m)
        overlaps, good, total = [], Counter[str](), Counter[str]()
        for frame in frames:
            T = Calibrator(CalibrationConfig()).add(frame.points).T_level_sensor
            levelled = remove.remove(frame.points, T)
            inside = levelled.cell >= 0
            truth = (frame.actor == -2) & inside
            overlaps.append((levelled.ground & truth).sum() / ((levelled.ground | truth) & inside).sum())
            found = group.cluster(levelled)
            _count_own(frame, inside, found.cluster_id, good, total)
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


def argoverse() -> None:
    """Precision and recall of the ground on the sweep whose points are labelled."""
    path = DATA / "labelled-argoverse2" / "log_7fab2350" / "sweep_315966265259836000.npz"
    if not path.exists():
        print("  no Argoverse sweep here (SPOTTER_DATA)")
        return
    with np.load(path) as file:
        points, truth = file["xyz"], file["is_ground"]
    T = Calibrator(CalibrationConfig()).add(points).T_level_sensor
    _score("ours", Ground(GroundConfig()).remove(points, T).ground, truth)
    _score("article", Ground(ARTICLE_GROUND).remove(points, T).ground, truth)
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


def main() -> None:
    calibration()
    print("\ngenerated streets, each with its own calibration")
    streets()
    print("\nArgoverse 2 sweep, ground against the dataset's ground map")
    argoverse()


if __name__ == "__main__":
    main()
