"""False vehicles beside a motorway: nothing learned, the background learned, the site's forest, and both.

    python -m benchmarks.infra_lidar.motorway

Ten single revolutions of one place, seconds apart, without labels. A cluster that is called car or large vehicle is
false when it is off the carriageways, or when more than half of its points are where the authors' model of the empty
road has a standing object. The model's road is left out: it is as coarse as half a metre, and the lower half of a car
would be taken for road. Training uses the other revolutions, never the one that is evaluated. No track continues from
one to the next, so only clutter gets labels; ``adapt`` refuses such a recording.
"""

from __future__ import annotations

from collections.abc import Iterator

import msgspec
import numpy as np
from scipy.spatial import cKDTree

from benchmarks.infra_lidar.accuracy import DATA
from services.infra_lidar.adaptation.labels import label_site
from services.infra_lidar.adaptation.recorder import SiteRecorder
from services.infra_lidar.adaptation.site_forest import (
    FEATURES,
    Examples,
    generated_examples,
    grow,
    join,
    site_examples,
)
from services.infra_lidar.calibration.plane_fit import Calibration
from services.infra_lidar.classification.classes import UNKNOWN, VEHICLES
from services.infra_lidar.classification.classifier import Classifier
from services.infra_lidar.classification.forest import Forest
from services.infra_lidar.config import BackgroundConfig, CalibrationConfig, ClassifierConfig, InfraLidarConfig
from services.infra_lidar.pipeline import InfraLidarPipeline
from services.infra_lidar.result import FrameResult

FOLDER = DATA / "roadside-lidar80"
ROADSIDE_MAST = CalibrationConfig(height_min_m=2.0, max_tilt_deg=10.0)
ROAD_Y_M = 16.0  # half the width between the guard rails, which stand at 16.2
SCENE_M, STANDS_M = 0.6, 0.5  # reach of a point of the empty road; what is higher than that above the road stands
FOLDS = 3
APART_NS = 10_000_000_000
WHOLE = InfraLidarConfig(calibration=ROADSIDE_MAST, background=BackgroundConfig(enabled=False))


class EmptyRoad:
    """The static objects without traffic; T_level_sensor: where the road is."""

    def __init__(self, T_level_sensor: np.ndarray) -> None:
        with np.load(FOLDER / "background.npz") as stored:
            scene = stored["xyz"].astype(np.float32)
        height_m = scene @ T_level_sensor[2, :3] + T_level_sensor[2, 3]
        self._stands = cKDTree(scene[(height_m > STANDS_M) | (np.abs(scene[:, 1]) > ROAD_Y_M)])

    def explains(self, points: np.ndarray) -> bool:
        """Whether a cluster (n, 3), sensor frame, cannot be a vehicle."""
        off_the_road = abs(float(np.median(points[:, 1]))) > ROAD_Y_M
        return off_the_road or bool(np.mean(self._stands.query(points)[0] < SCENE_M) > 0.5)


def revolutions() -> list[np.ndarray]:
    """(N, 3) float32 points of each, sensor frame; none where the recording is not there."""
    found = []
    for path in sorted(FOLDER.glob("frame_*.npz")):
        with np.load(path) as stored:
            found.append(stored["xyz"].astype(np.float32))
    return found


def count(result: FrameResult, empty: EmptyRoad) -> tuple[int, int, int]:
    """False vehicles, the other vehicles, and clusters called unknown."""
    clusters, points = result.clusters, result.points[:, :3]
    called = np.flatnonzero(np.isin(clusters.classes, VEHICLES))
    rows = np.split(clusters.members, clusters.offsets[1:-1])
    false = sum(empty.explains(points[rows[k]]) for k in called)
    return false, len(called) - false, int(np.sum(clusters.classes == UNKNOWN))


def settled_calibration(frames: list[np.ndarray]) -> Calibration:
    """Where the road is, from the first revolutions."""
    pipeline = InfraLidarPipeline(WHOLE)
    for number, points in enumerate(frames[:5]):
        pipeline.process((number + 1) * APART_NS, points)
    calibration = pipeline.calibration.settled_calibration
    assert calibration is not None
    return calibration


def site_forest(frames: list[np.ndarray], calibration: Calibration, generated: Examples) -> Forest:
    """A forest trained with the clutter of these revolutions."""
    pipeline, recorder = InfraLidarPipeline(WHOLE, calibration), SiteRecorder(FEATURES, WHOLE.ground.range_max_m)
    for number, points in enumerate(frames):
        recorder.add(pipeline.process((number + 1) * APART_NS, points), {})
    record = recorder.record()
    return grow(join(generated, site_examples(record, label_site(record))), {"source": "a benchmark"})


def judged(
    learn: list[np.ndarray], judge: list[np.ndarray], calibration: Calibration, forest: Forest | None
) -> Iterator[FrameResult]:
    """Results for each revolution of ``judge``, with the background learned from ``learn``, if that is not empty."""
    background = BackgroundConfig(min_frames=max(len(learn), 5), learn_s=1.0, enabled=bool(learn))
    config = msgspec.structs.replace(WHOLE, background=background)
    pipeline = InfraLidarPipeline(config, calibration)
    if forest is not None:
        pipeline.classifier = Classifier(ClassifierConfig(), forest)
    for number, points in enumerate([*learn, *judge]):
        result = pipeline.process((number + 1) * APART_NS, points)
        if number >= len(learn):
            assert result.segmentation.background_subtracted == bool(learn)
            yield result


def main() -> None:
    """The command above."""
    frames = revolutions()
    if not frames:
        print("no roadside recording here (SPOTTER_DATA)")
        return
    calibration, generated = settled_calibration(frames), generated_examples(WHOLE)
    empty = EmptyRoad(calibration.T_level_sensor)
    rows: dict[str, list[tuple[int, int, int]]] = {}
    for fold in range(FOLDS):
        learn = [points for n, points in enumerate(frames) if n % FOLDS != fold]
        judge = [points for n, points in enumerate(frames) if n % FOLDS == fold]
        forest = site_forest(learn, calibration, generated)
        for name, of, used in (("nothing learned", [], None), ("background learned", learn, None),
                               ("site forest", [], forest), ("both", learn, forest)):  # fmt: skip
            rows.setdefault(name, []).extend(count(result, empty) for result in judged(of, judge, calibration, used))
    print(f"{'per revolution':<20}{'false vehicles':>16}{'most':>6}{'other vehicles':>16}{'unknown':>9}")
    for name, counts in rows.items():
        false, other, unknown = np.array(counts).T
        print(f"{name:<20}{np.mean(false):16.1f}{max(false):6d}{np.mean(other):16.1f}{np.mean(unknown):9.1f}")


if __name__ == "__main__":
    main()
