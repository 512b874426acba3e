"""Boxes of three data sets in one form: made-up files in their layouts, and the recordings where they are."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.datasets.labelled_boxes import ARGOVERSE_SENSOR_M, LabelledFrame, labelled_frames

TO_CAMERA = np.array([[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0]])  # x ahead to z ahead


def _numbers(values) -> str:
    return " ".join(str(v) for v in np.ravel(values))


def test_points_in_a_turned_box() -> None:
    box = np.array([[10.0, 0.0, 1.0, 4.0, 2.0, 2.0, np.pi / 2]])
    points = np.array([[10.0, 1.9, 1.0], [11.9, 0.0, 1.0], [10.9, -1.9, 1.9], [10.0, 0.0, 2.2]])
    frame = LabelledFrame("made up", points, box, ["car"])
    assert frame.inside(0, margin_m=0.0).tolist() == [True, False, True, False]
    assert frame.inside(0, margin_m=0.25).tolist() == [True, False, True, True]


def test_an_argoverse_sweep_is_seen_from_its_sensor(tmp_path: Path) -> None:
    log = tmp_path / "labelled-argoverse2" / "log_7fab2350"
    log.mkdir(parents=True)
    np.savez(log / "sweep_7.npz", xyz=np.array([[10.0, 2.0, 0.5]]))
    head = "timestamp_ns,category,x,y,z,length,width,height,yaw\n"
    rows = ["7,REGULAR_VEHICLE,10,2,0.7,4,2,1.4,0.1\n", "7,BOLLARD,1,1,1,1,1,1,0\n", "8,BUS,0,0,0,1,1,1,0\n"]
    (log / "annotations.csv").write_text(head + "".join(rows))
    (frame,) = labelled_frames(tmp_path)
    assert frame.labels == ["car"]
    assert frame.boxes[0] == pytest.approx([*(np.array([10, 2, 0.7]) - ARGOVERSE_SENSOR_M), 4, 2, 1.4, 0.1])
    assert frame.inside(0).all()


def test_kitti_boxes_come_from_the_camera_s_frame(tmp_path: Path) -> None:
    folder = tmp_path / "labelled-kitti"
    for name in ("calib", "label_2", "velodyne", "velodyne_front_only"):
        (folder / name).mkdir(parents=True)
    calib = f"R0_rect: {_numbers(np.eye(3))}\nTr_velo_to_cam: {_numbers(TO_CAMERA)}\n"
    (folder / "calib" / "000000.txt").write_text(calib)
    # height width length, then the middle of the floor: 10 m ahead, 2 m to the left, 1.7 m down; facing right
    (folder / "label_2" / "000000.txt").write_text("Car 0 0 0 0 0 0 0 1.5 1.8 4.0 -2.0 1.7 10.0 0.0\n")
    np.array([[10.0, 3.9, -1.0, 0.5], [11.5, 2.0, -1.0, 0.5]], np.float32).tofile(folder / "velodyne" / "000000.bin")
    one = {"bbox_3d": [-2.0, 1.7, 10.0, 4.0, 1.5, 1.8, 0.0]}
    camera = {"lidar2cam": [*TO_CAMERA.tolist(), [0.0, 0.0, 0.0, 1.0]]}
    scene = {"data_list": [{"images": {"CAM2": camera}, "instances": [one]}]}
    (folder / "velodyne_front_only" / "000008.json").write_text(json.dumps(scene))
    np.zeros((1, 4), np.float32).tofile(folder / "velodyne_front_only" / "000008.bin")
    whole, front = labelled_frames(tmp_path)
    assert whole.boxes[0] == pytest.approx([10.0, 2.0, -0.95, 4.0, 1.8, 1.5, -np.pi / 2])
    assert whole.inside(0, margin_m=0.0).tolist() == [True, False]
    assert front.boxes[0] == pytest.approx(whole.boxes[0])
    assert whole.labels == front.labels == ["car"]


def test_nuscenes_boxes_are_the_lidar_s(tmp_path: Path) -> None:
    folder = tmp_path / "labelled-nuscenes"
    folder.mkdir()
    known = {"bbox_label_3d": 3, "bbox_3d": [1, 2, 3, 12, 2.5, 3, 0.5]}
    document = {
        "metainfo": {"categories": {"bus": 3}},
        "data_list": [{"instances": [known, known | {"bbox_label_3d": -1}]}],
    }
    (folder / "frame.json").write_text(json.dumps(document))
    np.zeros((2, 5), np.float32).tofile(folder / "n015__LIDAR_TOP__1.pcd.bin")
    (frame,) = labelled_frames(tmp_path)
    assert frame.labels == ["large_vehicle"]
    assert frame.points.shape == (2, 3)


def test_a_folder_without_recordings_gives_nothing(tmp_path: Path) -> None:
    assert list(labelled_frames(tmp_path)) == []


def test_boxes_of_the_recording_hold_the_points_that_the_data_set_counts(recordings) -> None:
    frames = [f for f in labelled_frames(recordings("labelled-kitti").parent) if f.data_set == "KITTI"]
    assert [frames[0].inside(0, margin_m=0.0).sum()] == pytest.approx([376], rel=0.02)
    counted = [frames[1].inside(k, margin_m=0.0).sum() for k in range(6)]
    assert counted == pytest.approx([1325, 1900, 881, 659, 55, 162], rel=0.01)
