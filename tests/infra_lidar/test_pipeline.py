"""The whole pipeline: the contract of its result, generated streets, and the standing recording."""

import msgpack
import numpy as np
import pytest

from common.codec import encode
from services.infra_lidar.calibration.store import Store
from services.infra_lidar.config import BackgroundConfig, ClusteringConfig, GroundConfig, InfraLidarConfig
from services.infra_lidar.input.source import surveyed_pose
from services.infra_lidar.pipeline import InfraLidarPipeline
from services.infra_lidar.warm_up import made_up_revolution
from spotter_sim import lidar128

START_NS = 1_700_000_000_000_000_000
LEARN_FAST = BackgroundConfig(learn_s=0.5, min_frames=6)


def _stamp(k):
    return START_NS + k * 100_000_000


def test_the_result_has_what_the_contract_names(scene_frame):
    frame = scene_frame("open", 4)
    result = InfraLidarPipeline(InfraLidarConfig()).process(START_NS, frame.points)
    n = len(frame.points)
    assert result.ground.shape == (n,)
    assert result.ground.dtype == bool
    assert result.cluster_id.shape == (n,)
    assert result.cluster_id.dtype == np.int32
    assert result.cluster_id.min() == -1
    assert result.cluster_id.max() == len(result.clusters) - 1
    assert not (result.ground & (result.cluster_id >= 0)).any()
    clusters = result.clusters
    k = len(clusters)
    assert len(clusters.labels) == len(clusters.confidences) == len(clusters.boxes) == len(clusters.features) == k > 20
    assert {"ground", "cluster", "classify", "track"} <= set(result.stage_ms)
    assert np.allclose(result.T_level_sensor, frame.T_level_sensor, atol=0.03)
    assert result.tracks.points_in == n
    assert result.tracks.stamp_ns == START_NS


def test_results_of_earlier_frames_stay_as_they_were(scene_frame):
    pipeline = InfraLidarPipeline(InfraLidarConfig())
    first = pipeline.process(START_NS, scene_frame("open", 4).points)
    ground, ids = first.ground.copy(), first.cluster_id.copy()
    pipeline.process(_stamp(1), scene_frame("open", 5).points)
    assert np.array_equal(first.ground, ground)
    assert np.array_equal(first.cluster_id, ids)


def test_the_same_frames_give_the_same_result(scene_frame):
    def run():
        pipeline = InfraLidarPipeline(InfraLidarConfig())
        results = [pipeline.process(_stamp(k), scene_frame("open", 4, t_s=5.0 + 0.1 * k).points) for k in range(4)]
        return results[-1]

    a, b = run(), run()
    assert np.array_equal(a.cluster_id, b.cluster_id)
    assert [t.position_m for t in a.tracks.tracks] == [t.position_m for t in b.tracks.tracks]


@pytest.mark.parametrize("points", [np.zeros(5), np.zeros((5, 2)), np.array([["a", "b", "c"]])])
def test_other_shapes_are_refused(points):
    with pytest.raises(ValueError, match=r"expected an \(N, 3\+\) array"):
        InfraLidarPipeline(InfraLidarConfig()).process(START_NS, points)


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.zeros((2000, 5)), np.full((2000, 4), np.nan)])
def test_a_blind_sensor_says_so_and_publishes_nothing(points):
    result = InfraLidarPipeline(InfraLidarConfig()).process(START_NS, points)
    assert result.tracks.state == "degraded"
    assert "not calibrated" in result.tracks.reason
    assert result.tracks.tracks == []
    assert len(result.clusters) == 0
    assert (result.cluster_id == -1).all()


def test_other_number_types_are_read(scene_frame):
    points = scene_frame("level", 4).points
    as_double = InfraLidarPipeline(InfraLidarConfig()).process(START_NS, points.astype(np.float64))
    as_float = InfraLidarPipeline(InfraLidarConfig()).process(START_NS, points)
    assert np.array_equal(as_double.cluster_id, as_float.cluster_id)


def test_messages_are_readable_by_anybody(scene_frame):
    result = InfraLidarPipeline(InfraLidarConfig()).process(START_NS, scene_frame("open", 4).points)
    clusters = msgpack.unpackb(encode(result.clusters_message()))
    assert len(clusters["clusters"]) == len(result.clusters)
    cloud = msgpack.unpackb(encode(result.points_message(5000)))
    assert 2500 < cloud["points"]["shape"][0] <= 5000
    assert len(cloud["kind"]["data"]) == cloud["points"]["shape"][0]


@pytest.mark.parametrize("nothing", [np.nan, np.inf, 0.0])
def test_rows_that_are_no_returns_are_not_published(nothing):
    points = made_up_revolution().points.copy()
    points[::3, :3] = nothing
    cloud = InfraLidarPipeline(InfraLidarConfig()).process(START_NS, points).points_message(1_000_000)
    assert np.isfinite(cloud.points).all()
    assert len(cloud.points) == len(cloud.kind) == len(cloud.intensity) == len(points) - len(points[::3])


def test_tracks_are_in_the_surveyed_map_frame():
    pose = surveyed_pose(InfraLidarConfig(source="sim:crossing"))
    pipeline = InfraLidarPipeline(InfraLidarConfig(T_map_sensor=pose))
    errors = []
    from spotter_sim import world

    for k in range(12):
        t_s = 4.0 + 0.1 * k
        scan = lidar128.scan("crossing", t_s, 900)
        result = pipeline.process(_stamp(k), np.column_stack([scan.xyz, scan.intensity, scan.ring]))
    actors = [a for a in world.world_at("crossing", t_s).actors if a.kind in ("car", "bus", "pedestrian", "cyclist")]
    for track in result.tracks.tracks:
        if track.state == "confirmed" and track.points > 100:
            apart = [np.hypot(*(np.array(track.position_m[:2]) - a.position_m[:2])) for a in actors]
            errors.append(min(apart, default=np.inf))
    assert sum(e < 1.5 for e in errors) >= 2


def test_recalibration_begins_anew():
    pipeline = InfraLidarPipeline(InfraLidarConfig(background=LEARN_FAST))
    frame = made_up_revolution().points
    for k in range(14):
        pipeline.process(_stamp(k), frame)
    assert pipeline.calibration.settled
    assert pipeline.scene.background.model is not None
    pipeline.recalibrate()
    assert not pipeline.calibration.settled
    assert pipeline.scene.background.model is None
    assert pipeline.process(_stamp(20), frame).T_level_sensor[2, 3] == pytest.approx(4.0, abs=0.02)


def test_what_was_learned_survives_a_restart(tmp_path):
    config, frame = InfraLidarConfig(background=LEARN_FAST), made_up_revolution().points
    store = Store(str(tmp_path / "infra0"))
    first = InfraLidarPipeline(config, *store.load())
    for k in range(14):
        first.process(_stamp(k), frame)
        store.keep(first.calibration.settled_calibration, first.scene.background.model)
    second = InfraLidarPipeline(config, *Store(str(tmp_path / "infra0")).load())
    result = second.process(_stamp(30), frame)
    assert second.calibration.settled
    assert np.allclose(result.T_level_sensor, first.process(_stamp(31), frame).T_level_sensor)
    assert result.background.mean() > 0.5


@pytest.mark.parametrize(
    "other",
    [{"ground": GroundConfig(ring_m=5.0)}, {"clustering": ClusteringConfig(cell_m=0.2)}],
    ids=["ground", "clusters"],
)
def test_a_background_learned_with_other_cells_is_learned_anew(tmp_path, other):
    store, frame = Store(str(tmp_path)), made_up_revolution().points
    first = InfraLidarPipeline(InfraLidarConfig(background=LEARN_FAST), *store.load())
    for k in range(14):
        first.process(_stamp(k), frame)
        store.keep(first.calibration.settled_calibration, first.scene.background.model)
    second = InfraLidarPipeline(InfraLidarConfig(background=LEARN_FAST, **other), *Store(str(tmp_path)).load())
    assert not second.process(_stamp(30), frame).background.any()
    for k in range(31, 45):
        result = second.process(_stamp(k), frame)
    assert result.background.mean() > 0.5


@pytest.mark.parametrize("name", ["calibration.json", "background.npz"])
@pytest.mark.parametrize(
    "content", [b"", b"{}", b"PK\x03\x04", b'{"T_level_sensor": [[1]]}'], ids=["empty", "none", "zip", "tiny"]
)
def test_a_damaged_store_is_not_used(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    assert Store(str(tmp_path)).load() == (None, None)


def test_partial_revolutions_are_not_taken_for_a_moved_sensor(recording):
    from services.infra_lidar.sensor_health import FrameQuality

    with np.load(recording("lidar128-velodyne-vls128") / "scan_0.npz") as file:
        whole = file["xyz"]
    half = whole[whole[:, 1] > 0]
    pipeline = InfraLidarPipeline(InfraLidarConfig(background=BackgroundConfig(enabled=False)))
    for k in range(14):
        complete = k % 2 == 0 or k < 7
        result = pipeline.process(
            START_NS + k * 2_500_000_000, whole if complete else half, FrameQuality(complete=complete)
        )
    assert "moved" not in result.tracks.reason


@pytest.mark.slow
def test_nothing_moves_in_the_standing_recording(recording):
    folder = recording("lidar128-velodyne-vls128")
    frames = []
    for k in range(3):
        with np.load(folder / f"scan_{k}.npz") as file:
            frames.append(np.column_stack([file["xyz"], file["intensity"], file["ring"]]).astype(np.float32))
    pipeline = InfraLidarPipeline(InfraLidarConfig())
    fast = set()
    for k in range(90):
        result = pipeline.process(_stamp(k), frames[k % 3])
        fast |= {
            t.track_id for t in result.tracks.tracks if t.state == "confirmed" and np.hypot(*t.velocity_mps[:2]) > 1.0
        }
    assert len(result.tracks.tracks) > 10
    assert not fast


@pytest.mark.parametrize(
    ("folder", "name"),
    [("lidar128-ouster-os2", "os2_128_0.npz"), ("labelled-nuscenes", "n015*LIDAR_TOP*.bin"),
     ("labelled-kitti", "velodyne/000000.bin"), ("sequence-kitti-hdl64", "data_1_0000000000.npz"),
     ("roadside-lidar80", "frame_1659348509.npz")],
)  # fmt: skip
def test_every_recording_goes_through(recording, folder, name):
    from services.infra_lidar.input.point_files import parse_frame

    (path,) = recording(folder).glob(name)
    points = parse_frame(path.name, path.read_bytes()).points
    result = InfraLidarPipeline(InfraLidarConfig()).process(START_NS, points)
    assert not result.calibration.refused
    assert result.ground.mean() > 0.05
    assert len(result.clusters) > 10
