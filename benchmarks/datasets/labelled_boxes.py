"""Frames of three data sets with boxes around road users: Argoverse 2, KITTI, nuScenes (see the folders' READMEs).

All were recorded from vehicles, by sensors of 32 to 64 beams some two metres above the road; nothing here was used for
training.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ARGOVERSE_SENSOR_M = np.array([1.35, 0.0, 1.64])  # between the two lidars, in the vehicle's frame
_CLASS = {
    "car": ("REGULAR_VEHICLE", "Car", "Van", "car"),
    "large_vehicle": (
        "LARGE_VEHICLE", "BUS", "BOX_TRUCK", "TRUCK", "TRUCK_CAB", "VEHICULAR_TRAILER", "Truck", "truck", "bus",
        "trailer", "construction_vehicle",
    ),
    "pedestrian": ("PEDESTRIAN", "Pedestrian", "pedestrian"),
    "cyclist": ("BICYCLIST", "MOTORCYCLIST", "Cyclist"),
    "parked cycle": ("BICYCLE", "MOTORCYCLE", "bicycle", "motorcycle"),
}  # fmt: skip
CLASS_OF = {name: label for label, names in _CLASS.items() for name in names}
"""Category of a data set to our class; what is not here is left out. A cycle without its rider is no road user."""


@dataclass(frozen=True)
class LabelledFrame:
    """points: (N, 3) float32 metres, sensor in the middle. boxes: (K, 7) x y z of the centre, length width height, yaw.

    labels: K of our classes, or ``parked cycle``.
    """

    data_set: str
    points: np.ndarray
    boxes: np.ndarray
    labels: list[str]

    def inside(self, k: int, margin_m: float = 0.1) -> np.ndarray:
        """(N,) bool: points in box k, widened by the margin on every side."""
        box = self.boxes[k]
        offset = self.points - box[:3]
        c, s = np.cos(box[6]), np.sin(box[6])
        local = np.column_stack(
            [c * offset[:, 0] + s * offset[:, 1], c * offset[:, 1] - s * offset[:, 0], offset[:, 2]]
        )
        return np.asarray(np.all(np.abs(local) <= box[3:6] / 2 + margin_m, axis=1))


def labelled_frames(data: Path) -> Iterator[LabelledFrame]:
    """Every frame with boxes that there is in the folder of recordings."""
    for path in sorted((data / "labelled-argoverse2" / "log_7fab2350").glob("sweep_*.npz")):
        yield _argoverse(path)
    if (data / "labelled-kitti").exists():
        yield from (_kitti(data / "labelled-kitti", "000000"), _kitti_front(data / "labelled-kitti", "000008"))
    for path in (data / "labelled-nuscenes").glob("*LIDAR_TOP*.bin"):
        yield _nuscenes(path)


def _frame(name: str, points: np.ndarray, rows: list[tuple[str, list[float]]]) -> LabelledFrame:
    known = [(CLASS_OF[category], box) for category, box in rows if category in CLASS_OF]
    boxes = np.array([box for _, box in known]).reshape(-1, 7)
    return LabelledFrame(name, points.astype(np.float32), boxes, [label for label, _ in known])


def _argoverse(path: Path) -> LabelledFrame:
    stamp = path.stem.split("_")[1]
    with np.load(path) as file:
        points = file["xyz"] - ARGOVERSE_SENSOR_M
    columns = ("x", "y", "z", "length", "width", "height", "yaw")
    with (path.parent / "annotations.csv").open() as file_:
        rows = [r for r in csv.DictReader(file_) if r["timestamp_ns"] == stamp]
    boxes = [(r["category"], [float(r[c]) for c in columns]) for r in rows]
    for _, box in boxes:
        box[:3] = list(np.array(box[:3]) - ARGOVERSE_SENSOR_M)
    return _frame("Argoverse 2", points, boxes)


def _kitti(folder: Path, number: str) -> LabelledFrame:
    lines = (line.split(":") for line in (folder / "calib" / f"{number}.txt").read_text().splitlines() if ":" in line)
    calib = {key: np.array(values.split(), float) for key, values in lines}
    T_rect_lidar = np.eye(4)
    T_rect_lidar[:3] = calib["R0_rect"].reshape(3, 3) @ calib["Tr_velo_to_cam"].reshape(3, 4)
    rows = []
    for line in (folder / "label_2" / f"{number}.txt").read_text().splitlines():
        kind, *values = line.split()
        h, w, length, x, y, z, turn = map(float, values[7:14])
        rows.append((kind, _from_camera(T_rect_lidar, [x, y, z], [length, w, h], turn)))
    points = np.fromfile(folder / "velodyne" / f"{number}.bin", np.float32).reshape(-1, 4)[:, :3]
    return _frame("KITTI", points, rows)


def _kitti_front(folder: Path, number: str) -> LabelledFrame:
    front = folder / "velodyne_front_only"
    scene = json.loads((front / f"{number}.json").read_text())["data_list"][0]
    T_camera_lidar = np.array(scene["images"]["CAM2"]["lidar2cam"])
    rows = []
    for one in scene["instances"]:
        x, y, z, length, height, width, turn = one["bbox_3d"]
        rows.append(("Car", _from_camera(T_camera_lidar, [x, y, z], [length, width, height], turn)))
    points = np.fromfile(front / f"{number}.bin", np.float32).reshape(-1, 4)[:, :3]
    return _frame("KITTI", points, rows)


def _from_camera(T_camera_lidar: np.ndarray, foot: list[float], size: list[float], turn_rad: float) -> list[float]:
    """A box given by the middle of its floor in the camera's frame (y down, turn about y) in the lidar's."""
    T = np.linalg.inv(T_camera_lidar)
    x, y, z = T[:3, :3] @ foot + T[:3, 3]
    return [x, y, z + size[2] / 2, *size, -turn_rad - np.pi / 2]


def _nuscenes(path: Path) -> LabelledFrame:
    document = json.loads((path.parent / "frame.json").read_text())
    names = {number: name for name, number in document["metainfo"]["categories"].items()}
    found = document["data_list"][0]["instances"]
    rows = [(names.get(one["bbox_label_3d"], ""), list(map(float, one["bbox_3d"]))) for one in found]
    return _frame("nuScenes", np.fromfile(path, np.float32).reshape(-1, 5)[:, :3], rows)
