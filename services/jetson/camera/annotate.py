"""A picture for people: boxes, distances, the forward zone and the camera's own state, as JPEG."""

from __future__ import annotations

import cv2
import numpy as np

from common.messages import CameraDetection, CameraDetections, CompressedImage
from services.jetson.camera.config import ImageConfig, ZoneConfig
from services.jetson.camera.zone import forward_zone

LEVEL_BGR = {"SAFE": (80, 175, 76), "CAUTION": (0, 170, 255), "IMMINENT": (40, 40, 225)}
_GREY, _BLACK = (170, 170, 170), (0, 0, 0)
_FONT = cv2.FONT_HERSHEY_SIMPLEX
FONT_PER_COLUMN = 0.65 / 640  # large enough to be read when the picture is shown at half its size


def picture(image: np.ndarray, seen: CameraDetections, zone: ZoneConfig, config: ImageConfig) -> CompressedImage:
    """(H, W, 3) uint8 BGR and what was seen in it, to a JPEG message with the same stamp. The picture is not changed.

    Raises:
        ValueError: the picture cannot be encoded.
    """
    drawn = draw(image, seen, zone, config.max_width_px)
    encoded, jpeg = cv2.imencode(".jpg", drawn, (cv2.IMWRITE_JPEG_QUALITY, config.quality))
    if not encoded:
        raise ValueError(f"a picture of shape {drawn.shape} does not encode as JPEG")
    return CompressedImage(
        stamp_ns=seen.stamp_ns,
        frame_id=seen.frame_id,
        received_ns=seen.received_ns,
        state=seen.state,
        reason=seen.reason,
        format="jpeg",
        data=jpeg.tobytes(),
        captions=[f"{caption(one)}{'' if one.in_zone else ' (beside)'}" for one in nearest_first(seen)],
    )


def draw(image: np.ndarray, seen: CameraDetections, zone: ZoneConfig, max_width_px: int) -> np.ndarray:
    """A copy, at most ``max_width_px`` wide, with everything drawn in."""
    rows, columns = image.shape[:2]
    scale = min(1.0, max_width_px / columns)
    size = (round(columns * scale), round(rows * scale))
    canvas = cv2.resize(image, size, interpolation=cv2.INTER_AREA) if scale < 1 else image.copy()
    for edge_px in forward_zone(size[0], zone):
        cv2.line(canvas, (round(edge_px), 0), (round(edge_px), size[1]), _GREY, 1)
    for detection in reversed(nearest_first(seen)):  # the nearest box over the others
        left, top, right, bottom = _box(detection, scale)
        cv2.rectangle(canvas, (left, top), (right, bottom), _colour(detection), 2)
    taken: list[tuple[int, int, int, int]] = []
    for detection in nearest_first(seen):  # the nearest says its name where it wants
        taken.append(_draw_caption(canvas, detection, scale, taken))
    if seen.state == "degraded":
        cv2.rectangle(canvas, (0, 0), (size[0], 24), _BLACK, cv2.FILLED)
        cv2.putText(canvas, f"DEGRADED {seen.reason}", (6, 17), _FONT, 0.5, LEVEL_BGR["CAUTION"], 1, cv2.LINE_AA)
    return canvas


def nearest_first(seen: CameraDetections) -> list[CameraDetection]:
    """The detections by distance."""
    return sorted(seen.detections, key=lambda detection: detection.distance_m)


def caption(detection: CameraDetection) -> str:
    """For example ``person 2.4 m`` or, when the box is cut off, ``person <= 2.4 m``."""
    at_most = "<= " if detection.truncated else ""
    nearest_m = detection.distance_m if detection.nearest_m is None else detection.nearest_m
    return f"{detection.label} {at_most}{nearest_m:.1f} m"


def _box(detection: CameraDetection, scale: float) -> tuple[int, int, int, int]:
    left, top, right, bottom = (round(value * scale) for value in detection.box_xyxy_px)
    return left, top, right, bottom


def _colour(detection: CameraDetection) -> tuple[int, int, int]:
    return LEVEL_BGR[detection.level] if detection.in_zone else _GREY


def _draw_caption(
    canvas: np.ndarray, detection: CameraDetection, scale: float, taken: list[tuple[int, int, int, int]]
) -> tuple[int, int, int, int]:
    """Above the box, inside the picture, and below whatever caption is there already; returns its place."""
    text, size = caption(detection), FONT_PER_COLUMN * canvas.shape[1]
    (width, height), _ = cv2.getTextSize(text, _FONT, size, 1)
    width, height = width + 6, height + 8
    left, top, _, _ = _box(detection, scale)
    left = max(0, min(left, canvas.shape[1] - width))
    top = max(top - height, 0)
    while any(x < left + width and left < x + w and y < top + height and top < y + h for x, y, w, h in taken):
        top += height
    cv2.rectangle(canvas, (left, top), (left + width, top + height), _colour(detection), cv2.FILLED)
    cv2.putText(canvas, text, (left + 3, top + height - 5), _FONT, size, _BLACK, 1, cv2.LINE_AA)
    return left, top, width, height
