"""What the pipeline learns of its scene: fixed things, parked vehicles, and ground that lies below the road."""

import numpy as np

from services.infra_lidar.calibration.store import Store
from services.infra_lidar.classification.classes import BACKGROUND, CLASSES, UNKNOWN
from services.infra_lidar.config import BackgroundConfig, InfraLidarConfig
from services.infra_lidar.pipeline import InfraLidarPipeline
from services.infra_lidar.sensor_health import FrameQuality
from services.infra_lidar.warm_up import made_up_revolution

START_NS = 1_700_000_000_000_000_000
LEARN_FAST = BackgroundConfig(learn_s=0.5, min_frames=6)


def _stamp(k):
    return START_NS + k * 100_000_000


def test_objects_are_found_as_before_once_the_scene_is_learned(scene_frame):
    frames = [scene_frame("open", 4, 25, t_s=4.0 + 0.1 * k, columns=900) for k in range(20)]
    config = InfraLidarConfig(background=BackgroundConfig(learn_s=0.5, min_frames=8, azimuth_cells=900))
    pipeline = InfraLidarPipeline(config)
    for k, frame in enumerate(frames):
        result = pipeline.process(_stamp(k), frame.points)
    assert result.background.mean() > 0.5
    truth, last = frames[-1].actor, frames[-1]
    level_z = last.points[:, :3] @ last.T_level_sensor[2, :3] + last.T_level_sensor[2, 3]
    upright = (truth > 0) & (level_z > 0.6) & (np.linalg.norm(last.points[:, :3], axis=1) < 50)
    whole = InfraLidarPipeline(InfraLidarConfig(background=BackgroundConfig(enabled=False)))
    without = whole.process(START_NS, last.points)
    seen_before = upright & (without.cluster_id >= 0)
    assert (result.cluster_id[seen_before] >= 0).mean() > 0.97
    truly_ground = truth == -2
    assert (result.ground == truly_ground)[np.abs(level_z) < 2].mean() > 0.94


def _call_everything(monkeypatch, pipeline, label, confidence):
    """Let the pipeline's classifier call every cluster the same."""
    extract = pipeline.classifier.extract_and_classify

    def called(*clusters):
        found = extract(*clusters)
        sure = np.full(len(found.labels), confidence, np.float32)
        return found._replace(labels=np.full_like(found.labels, label), confidence=sure)

    monkeypatch.setattr(pipeline.classifier, "extract_and_classify", called)


def _static_cells_learned(monkeypatch, label, confidence):
    """Bird's-eye cells of the static map, when every cluster was called the same all along."""
    pipeline, frame = InfraLidarPipeline(InfraLidarConfig(background=LEARN_FAST)), made_up_revolution().points
    _call_everything(monkeypatch, pipeline, label, confidence)
    found = [len(pipeline.process(_stamp(k), frame).clusters) for k in range(14)]
    assert found[0] > 0
    return int(pipeline.scene.background.model.static_map.sum())


def test_who_may_be_a_road_user_as_learning_ends_is_not_drawn_as_static(monkeypatch):
    fixed = _static_cells_learned(monkeypatch, BACKGROUND, 0.9)
    assert fixed > 0
    unsure = _static_cells_learned(monkeypatch, CLASSES.index("car"), 0.5)
    assert unsure < fixed
    assert unsure == _static_cells_learned(monkeypatch, UNKNOWN, 0.3)


def test_a_large_vehicle_that_stands_while_learning_must_be_sure(monkeypatch):
    """Hedges look like buses, and a bus is seldom parked for all of the learning."""
    large = CLASSES.index("large_vehicle")
    fixed = _static_cells_learned(monkeypatch, BACKGROUND, 0.9)
    assert _static_cells_learned(monkeypatch, large, 0.93) == fixed
    assert _static_cells_learned(monkeypatch, large, 0.97) < fixed


def _road_beside_a_bank():
    """(N, 3) sensor frame: a road 4 m below, lower ground from y = 12 m on, and a box of a car's size on either."""
    rng = np.random.default_rng(5)
    xy = rng.uniform(-40.0, 40.0, (60_000, 2))
    xy = xy[np.hypot(*xy.T) > 3.0]
    ground = np.column_stack([xy, np.where(xy[:, 1] > 12.0, -6.5, -4.0)])
    box = rng.uniform([-2.1, -0.9, -3.7], [2.1, 0.9, -2.5], (600, 3))
    boxes = [box + np.array([8.0, y_m, 0.0]) for y_m in (6.0, 20.0)]
    return np.vstack([ground, *boxes]).astype(np.float32)


def test_no_vehicle_is_believed_over_lower_ground_and_it_is_learned_there(monkeypatch):
    pipeline, points = InfraLidarPipeline(InfraLidarConfig(background=LEARN_FAST)), _road_beside_a_bank()
    _call_everything(monkeypatch, pipeline, CLASSES.index("car"), 0.95)
    for k in range(14):
        result = pipeline.process(_stamp(k), points)
        assert result.segmentation.background_subtracted or dict(_called(result)) == {6: "car", 20: "unknown"}
        assert {track.label for track in result.tracks.tracks if track.position_m[1] > 12.0} <= {"unknown"}
    assert result.segmentation.background_subtracted
    called = dict(_called(result))
    assert called.pop(20, "background") == "background"
    assert called == {6: "car"}


def _called(result):
    """Place across the road (m) and label of each cluster."""
    return [
        (round(float(box[1])), label) for box, label in zip(result.clusters.boxes, result.clusters.labels, strict=True)
    ]


def test_drops_survive_a_restart(tmp_path, monkeypatch):
    config, points, store = InfraLidarConfig(background=LEARN_FAST), _road_beside_a_bank(), Store(str(tmp_path))
    first = InfraLidarPipeline(config, *store.load())
    for k in range(14):
        first.process(_stamp(k), points)
        store.keep(first.calibration.settled_calibration, first.scene.background.model)
    second = InfraLidarPipeline(config, *Store(str(tmp_path)).load())
    assert second.process(_stamp(30), points).segmentation.background_subtracted
    places = np.array([8.0, 8.0]), np.array([6.0, 20.0])
    assert list(second.scene.on_drop(*places)) == [False, True]


def test_drops_are_looked_for_in_whole_revolutions_only():
    pipeline, points = InfraLidarPipeline(InfraLidarConfig(background=LEARN_FAST)), _road_beside_a_bank()
    places = np.array([8.0]), np.array([20.0])
    pipeline.process(_stamp(0), points[points[:, 1] < 12.0], FrameQuality(complete=False))
    assert not pipeline.scene.on_drop(*places)
    pipeline.process(_stamp(1), points)
    assert pipeline.scene.on_drop(*places)
