"""Pictures of a camera that is mounted on its side, upside down or behind a mirror, turned upright as they arrive.

Everything behind this step sees upright pictures: detection, distances, strips, the picture on the page, recordings.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator

import cv2
import numpy as np

from services.jetson.camera.config import CaptureConfig, LensConfig
from services.jetson.camera.frames import Frame, Source

SIDEWAYS = (90, 270)
_TURNS = {90: cv2.ROTATE_90_CLOCKWISE, 180: cv2.ROTATE_180, 270: cv2.ROTATE_90_COUNTERCLOCKWISE}
_FLIPS = {"horizontal": 1, "vertical": 0}


def upright(image: np.ndarray, config: CaptureConfig) -> np.ndarray:
    """(H, W, 3) uint8 as the camera gives it to the upright picture, (W, H, 3) after a quarter turn."""
    if config.rotate_deg:
        image = cv2.rotate(image, _TURNS[config.rotate_deg])
    return image if config.flip == "none" else cv2.flip(image, _FLIPS[config.flip])


def turned(source: Source, config: CaptureConfig) -> Source:
    """The same source with upright pictures."""
    if not config.rotate_deg and config.flip == "none":
        return source

    def run(stop: threading.Event) -> Iterator[Frame]:
        for frame in source(stop):
            yield frame._replace(image=upright(frame.image, config))

    return run


def lens_of_upright(lens: LensConfig, capture: CaptureConfig, width_px: int, height_px: int) -> LensConfig:
    """The lens for upright pictures of this size.

    ``[lens]`` holds for upright pictures, as ``snap`` takes them. One that is wider than high while a quarter turn
    makes the picture higher than wide (or the other way) was meant before the turn: it is turned with the picture.
    """
    same_shape = (lens.width_px > lens.height_px) == (width_px > height_px)
    if capture.rotate_deg not in SIDEWAYS or same_shape:
        return lens
    clockwise = capture.rotate_deg == SIDEWAYS[0]
    tangential = lens.distortion[2:4]
    if tangential:  # p1 belongs to the rows, p2 to the columns, each with the sign of its axis
        p1, p2 = tangential
        tangential = (p2, -p1) if clockwise else (-p2, p1)
    return LensConfig(
        width_px=lens.height_px,
        height_px=lens.width_px,
        f_x_px=lens.f_y_px,
        f_y_px=lens.f_x_px,
        c_x_px=lens.height_px - lens.c_y_px if clockwise else lens.c_y_px,
        c_y_px=lens.c_x_px if clockwise else lens.width_px - lens.c_x_px,
        distortion=(*lens.distortion[:2], *tangential, *lens.distortion[4:]),
    )
