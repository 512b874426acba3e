"""Distances against labels: KITTI's boxes with true depth, or any other list of labelled objects."""

from __future__ import annotations

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np

from common.messages import CameraDetection
from services.jetson.camera.config import LensConfig

CLASS_OF = {"Car": "car", "Van": "car", "Truck": "truck", "Pedestrian": "person", "Cyclist": "bicycle"}
MIN_OVERLAP = 0.4


class Label(NamedTuple):
    kind: str  # KITTI's word
    box_xyxy_px: tuple[float, float, float, float]
    depth_m: float  # z of the object's middle in the camera frame: along the optical axis


class Error(NamedTuple):
    """One matched object: its true depth, ours, and what plain f * H / h makes of the same box."""

    label: Label
    distance_m: float
    plain_m: float
    truncated: bool

    @property
    def ours(self) -> float:
        return abs(self.distance_m - self.label.depth_m) / self.label.depth_m

    @property
    def plain(self) -> float:
        return abs(self.plain_m - self.label.depth_m) / self.label.depth_m


def tracking_labels(text: str) -> dict[int, list[Label]]:
    """KITTI tracking labels (frame, id, type, truncated, occluded, alpha, box, h w l, x y z, yaw) by frame."""
    found: dict[int, list[Label]] = {}
    for line in text.splitlines():
        frame, _, *rest = line.split()
        found.setdefault(int(frame), []).extend(_label(rest))
    return found


def object_labels(text: str) -> list[Label]:
    """KITTI object labels: the same columns without frame and id."""
    return [label for line in text.splitlines() for label in _label(line.split())]


def json_labels(text: str) -> list[Label]:
    """The labels of mmdetection3d's converted frame; its classes are pedestrian, cyclist, car."""
    instances = json.loads(text)["data_list"][0]["instances"]
    kinds = ("Pedestrian", "Cyclist", "Car")
    return [
        Label(kinds[i["bbox_label"]], tuple(i["bbox"]), float(i["depth"])) for i in instances if i["bbox_label"] >= 0
    ]


def projection(text: str, name: str = "P2") -> np.ndarray:
    """(3, 4) matrix of one camera from a KITTI calibration file.

    Raises:
        KeyError: it is not there.
    """
    for line in text.splitlines():
        key, _, values = line.partition(":")
        if key == name:
            return np.array(values.split(), float).reshape(3, 4)
    raise KeyError(name)


def lens_of(matrix: np.ndarray, width_px: int, height_px: int) -> LensConfig:
    """The lens of a (3, 4) projection matrix for a picture of this size."""
    return LensConfig(
        width_px=width_px,
        height_px=height_px,
        f_x_px=float(matrix[0, 0]),
        f_y_px=float(matrix[1, 1]),
        c_x_px=float(matrix[0, 2]),
        c_y_px=float(matrix[1, 2]),
    )


def compare(
    detections: list[CameraDetection], labels: list[Label], f_y_px: float, heights_m: dict[str, float]
) -> list[Error]:
    """Each label with the detection that overlaps it most, one to one, best overlap first."""
    pairs = sorted(
        (
            (overlap(d.box_xyxy_px, label.box_xyxy_px), i, k)
            for i, d in enumerate(detections)
            for k, label in enumerate(labels)
        ),
        reverse=True,
    )
    errors: list[Error] = []
    used: set[tuple[str, int]] = set()
    for share, i, k in pairs:
        wanted = CLASS_OF.get(labels[k].kind)
        if share < MIN_OVERLAP or {("d", i), ("l", k)} & used or wanted is None:
            continue
        used |= {("d", i), ("l", k)}
        detection = detections[i]
        _, top, _, bottom = detection.box_xyxy_px
        plain_m = f_y_px * heights_m.get(detection.label, heights_m[wanted]) / (bottom - top)
        errors.append(Error(labels[k], detection.distance_m, plain_m, detection.truncated))
    return errors


def overlap(one: tuple[float, ...], other: tuple[float, ...]) -> float:
    """Intersection over union of two boxes."""
    across = min(one[2], other[2]) - max(one[0], other[0])
    down = min(one[3], other[3]) - max(one[1], other[1])
    shared = max(across, 0.0) * max(down, 0.0)
    areas = [(box[2] - box[0]) * (box[3] - box[1]) for box in (one, other)]
    return shared / (sum(areas) - shared)


class Picture(NamedTuple):
    """A labelled picture, its lens, and where its labels came from."""

    path: Path
    labels: list[Label]
    projection: np.ndarray


def kitti_pictures(root: Path) -> list[Picture]:
    """The labelled street pictures below the recordings' folder; what is not there is left out."""
    tracking, objects = root / "camera" / "kitti_tracking_0001", root / "labelled-kitti"
    found = []
    if tracking.is_dir():
        by_frame = tracking_labels((tracking / "label.txt").read_text())
        matrix = projection((tracking / "calib.txt").read_text())
        found += [Picture(path, by_frame[int(path.stem)], matrix) for path in sorted(tracking.glob("*.png"))]
    if objects.is_dir():
        text = (objects / "label_2" / "000000.txt").read_text()
        matrix = projection((objects / "calib" / "000000.txt").read_text())
        found.append(Picture(objects / "image_2" / "000000.png", object_labels(text), matrix))
        converted = (objects / "velodyne_front_only" / "000008.json").read_text()
        matrix = np.array(json.loads(converted)["data_list"][0]["images"]["CAM2"]["cam2img"])[:3]
        found.append(Picture(objects / "image_2" / "000008.png", json_labels(converted), matrix))
    return found


def _label(words: list[str]) -> list[Label]:
    kind = words[0]
    if kind not in CLASS_OF:
        return []
    values = [float(word) for word in words[1:]]
    return [Label(kind, (values[3], values[4], values[5], values[6]), values[12])]
