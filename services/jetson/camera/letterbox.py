"""Picture to network input and back: scale with the aspect kept, pad with grey, undo it for the boxes."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

PADDING_GREY = 114  # what networks of this family are trained with


class Fit(NamedTuple):
    """How a picture was laid into the input: ``input = picture * scale + offset``."""

    scale: float
    left_px: int
    top_px: int


def letterbox(image: np.ndarray, width_px: int, height_px: int) -> tuple[np.ndarray, Fit]:
    """(H, W, 3) uint8 BGR to (1, 3, height, width) float32 RGB in 0..1, and the fit that was used."""
    rows, columns = image.shape[:2]
    scale = min(width_px / columns, height_px / rows)
    inner = (max(1, round(columns * scale)), max(1, round(rows * scale)))
    left, top = (width_px - inner[0]) // 2, (height_px - inner[1]) // 2
    if inner != (columns, rows):
        averaging = scale <= 0.5  # below that, interpolating would skip pixels
        image = cv2.resize(image, inner, interpolation=cv2.INTER_AREA if averaging else cv2.INTER_LINEAR)
    blob = np.full((1, 3, height_px, width_px), PADDING_GREY / 255, np.float32)
    for channel, plane in enumerate(reversed(cv2.split(image))):  # several times as fast as blobFromImage
        inside = blob[0, channel, top : top + inner[1], left : left + inner[0]]
        np.multiply(plane, np.float32(1 / 255), out=inside)
    return blob, Fit(scale, left, top)


def undo(boxes_xyxy: np.ndarray, fit: Fit, width_px: int, height_px: int) -> np.ndarray:
    """(N, 4) boxes in input pixels to picture pixels, clipped to the picture."""
    offset = np.array([fit.left_px, fit.top_px] * 2, dtype=np.float32)
    limit = np.array([width_px, height_px] * 2, dtype=np.float32)
    return np.clip((boxes_xyxy - offset) / np.float32(fit.scale), 0.0, limit)
