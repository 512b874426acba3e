"""Distances against labels: KITTI's boxes with true depth, or any other list of labelled objects."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from common.messages import CameraDetection
from services.jetson.camera.config import DistanceConfig, LensConfig, MountConfig
from services.jetson.camera.distance import Distance, estimate

CLASS_OF = {"Car": "car", "Van": "car", "Truck": "truck", "Pedestrian": "person", "Cyclist": "bicycle"}
MIN_OVERLAP = 0.4
SMALLEST_PX = 25.0  # height of a label's box that counts, as in KITTI's own evaluation
KITTI_SIZES_PX = {True: (1242, 375), False: (1224, 370)}  # by the row of the optical axis: above 171 or not
_STEPS = 9  # points of a solid along each of its sides


class Solid(NamedTuple):
    """A box in the camera's frame (x right, y down, z ahead), metres; x, y, z is the middle of its lower side."""

    height_m: float
    width_m: float
    length_m: float
    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float  # about y; 0 = its length lies along x


class Label(NamedTuple):
    """One labelled object of KITTI."""

    kind: str  # KITTI's word
    box_xyxy_px: tuple[float, float, float, float]
    solid: Solid

    @property
    def depth_m(self) -> float:
        """z of the object's middle: along the optical axis."""
        return self.solid.z_m


class Error(NamedTuple):
    """One matched object: its true depth, ours, and what plain f * H / h makes of the same box."""

    label: Label
    distance_m: float
    plain_m: float
    truncated: bool
    nearest_m: float  # the near end of what is possible

    @property
    def ours(self) -> float:
        """Relative error of the distance."""
        return abs(self.distance_m - self.label.depth_m) / self.label.depth_m

    @property
    def plain(self) -> float:
        """Relative error of f * H / h."""
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
    found = []
    for one in instances:
        if one["bbox_label"] >= 0:
            x_m, y_m, z_m, length_m, height_m, width_m, yaw_rad = one["bbox_3d"]
            solid = Solid(height_m, width_m, length_m, x_m, y_m, z_m, yaw_rad)
            found.append(Label(kinds[one["bbox_label"]], tuple(one["bbox"]), solid))
    return found


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
    """The lens of a camera matrix (3, 3), or projection matrix (3, 4), for a picture of this size; no distortion."""
    return LensConfig(
        width_px=width_px,
        height_px=height_px,
        f_x_px=float(matrix[0, 0]),
        f_y_px=float(matrix[1, 1]),
        c_x_px=float(matrix[0, 2]),
        c_y_px=float(matrix[1, 2]),
    )


def compare(
    detections: list[CameraDetection], labels: list[Label], lens: LensConfig, heights_m: dict[str, float]
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
        plain_m = lens.f_y_px * heights_m.get(detection.label, heights_m[wanted]) / (bottom - top)
        near_m = detection.distance_m if detection.nearest_m is None else detection.nearest_m
        errors.append(Error(labels[k], detection.distance_m, plain_m, detection.truncated, near_m))
    return errors


def nearest_in_view_m(solid: Solid, lens: LensConfig) -> float:
    """Depth of the nearest part of a box that lies in the picture; of its middle where no part does."""
    half = np.linspace(-0.5, 0.5, _STEPS)
    along, across, up = np.meshgrid(
        half * solid.length_m, half * solid.width_m, np.linspace(-1.0, 0.0, _STEPS) * solid.height_m, indexing="ij"
    )
    cosine, sine = math.cos(solid.yaw_rad), math.sin(solid.yaw_rad)
    z_m = (solid.z_m - sine * along + cosine * across).ravel()
    ahead = z_m > 0.1
    z_m = z_m[ahead]
    column_px = lens.f_x_px * (solid.x_m + cosine * along + sine * across).ravel()[ahead] / z_m + lens.c_x_px
    row_px = lens.f_y_px * (solid.y_m + up).ravel()[ahead] / z_m + lens.c_y_px
    inside = (column_px >= 0) & (column_px <= lens.width_px) & (row_px >= 0) & (row_px <= lens.height_px)
    return float(z_m[inside].min()) if inside.any() else solid.z_m


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


def label_boxes(
    root: Path, camera_m: float, noise_px: float, every: int = 1
) -> Iterator[tuple[Label, Distance, float]]:
    """Each labelled car and pedestrian of KITTI's tracking sequences: label, what the label's own 2-D box gives with
    such a noise of its sides (seeded), and the true depth of the nearest part in view. No network has a part in it.

    ``every``: only each so many frames.
    """
    rng, config, mount = np.random.default_rng(0), DistanceConfig(), MountConfig(height_m=camera_m)
    for path in sorted((root / "tracking-kitti" / "label").glob("*.txt")):
        matrix = projection((path.parent.parent / "calib" / path.name).read_text())
        lens = lens_of(matrix, *KITTI_SIZES_PX[matrix[1, 2] > 171.0])
        edge_px = np.array([lens.width_px, lens.height_px] * 2)
        for frame, labels in tracking_labels(path.read_text()).items():
            for label in labels:
                box = np.clip(np.array(label.box_xyxy_px) + rng.normal(0.0, noise_px, 4), 0.0, edge_px)
                wanted = label.kind in ("Car", "Pedestrian") and box[3] - box[1] >= SMALLEST_PX and label.depth_m > 0.5
                if wanted and frame % every == 0:
                    found = estimate(box, CLASS_OF[label.kind], lens, mount, config)
                    yield label, found, nearest_in_view_m(label.solid, lens)


def _label(words: list[str]) -> list[Label]:
    kind = words[0]
    if kind not in CLASS_OF:
        return []
    values = [float(word) for word in words[1:]]
    return [Label(kind, (values[3], values[4], values[5], values[6]), Solid(*values[7:14]))]
