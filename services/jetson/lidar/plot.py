"""Draw one scan: returns by reject reason, lanes, bands and zones. With OpenCV, so that it works on the Jetson."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import cv2
import numpy as np

from common.bus.service_app import check_output
from common.bus.status import Report
from common.config import ConfigError
from common.messages import LaserScan, LidarZones
from services.jetson.lidar.config import LidarConfig
from services.jetson.lidar.filters import RejectReason
from services.jetson.lidar.pipeline import LidarPipeline
from services.jetson.lidar.source import open_source
from services.jetson.lidar.zones import LANES

SIZE_PX = 900
MARGIN_PX = 110  # for the text
COLOURS = {  # BGR
    RejectReason.USED: (60, 60, 60),
    RejectReason.NEAR: (200, 60, 200),
    RejectReason.FAR: (200, 200, 200),
    RejectReason.BODY: (220, 160, 60),
    RejectReason.WEAK: (60, 180, 220),
    RejectReason.ISOLATED: (40, 40, 230),
    RejectReason.GRAZING: (40, 140, 230),
    RejectReason.IGNORED: (60, 170, 60),
}
LEVEL_COLOURS = {"SAFE": (90, 160, 60), "CAUTION": (30, 150, 240), "IMMINENT": (50, 50, 220)}
GREY = (150, 150, 150)


def plot_scans(config: LidarConfig, path: Path, scans: int) -> int:
    """Process so many turns of the source and draw the last one; returns how many there were.

    Raises:
        ConfigError: no turn came, or a picture cannot be made there.
        OSError: it cannot be written.
    """
    check_output(path, ".png", ".jpg")
    pipeline, count = LidarPipeline(config), 0
    for stamp_ns, scan in islice(open_source(config, Report("plot")), scans):
        zones, count = pipeline.process(stamp_ns, scan), count + 1
    if count == 0:
        raise ConfigError(f"source {config.source}: not one whole turn came; {path} is not drawn")
    save(path, draw(scan, pipeline.reject_reason, zones, config))
    return count


def draw(
    scan: LaserScan, reject_reason: np.ndarray, zones: LidarZones, config: LidarConfig, view_m: float = 3.5
) -> np.ndarray:
    """(H, W, 3) uint8 BGR picture: x forward is up, y left is left, ``view_m`` from the sensor to the upper edge."""
    canvas = _Canvas(view_m)
    _draw_lanes(canvas, zones, config)
    _draw_cone(canvas, config)
    x = scan.ranges_m * np.cos(scan.angles_rad) - config.mounting.front_m
    y = scan.ranges_m * np.sin(scan.angles_rad) + config.mounting.left_m
    for kind, colour in COLOURS.items():
        for px in canvas.at(x[reject_reason == kind], y[reject_reason == kind]):
            cv2.circle(canvas.image, tuple(px), 2, colour, -1, cv2.LINE_AA)
    _draw_text(canvas.image, reject_reason, zones)
    return canvas.image


def save(path: Path, picture: np.ndarray) -> None:
    """Write the picture; the format follows from the name.

    Raises:
        OSError: it cannot be written there.
    """
    _, data = cv2.imencode(path.suffix, picture)
    path.write_bytes(data.tobytes())


class _Canvas:
    """A white picture with the vehicle's bumper at two fifths from below."""

    def __init__(self, view_m: float) -> None:
        self.image = np.full((SIZE_PX + MARGIN_PX, SIZE_PX, 3), 255, np.uint8)
        self._px_per_m = 0.6 * SIZE_PX / view_m

    def at(self, x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
        """(N, 2) int pixels of points in the vehicle's frame."""
        column = SIZE_PX / 2 - np.asarray(y_m) * self._px_per_m
        row = MARGIN_PX + 0.6 * SIZE_PX - np.asarray(x_m) * self._px_per_m
        return np.column_stack([np.clip(column, -1e4, 1e4), np.clip(row, -1e4, 1e4)]).round().astype(int)

    def box(self, corners_m: list[tuple[float, float]], colour: tuple[int, int, int], width_px: int) -> None:
        """Draw a closed polygon, or a line between two corners; corners in m, vehicle frame."""
        x, y = np.array(corners_m).T
        cv2.polylines(self.image, [self.at(x, y)], len(corners_m) > 2, colour, width_px, cv2.LINE_AA)

    def say(self, text: str, x_m: float, y_m: float, colour: tuple[int, int, int]) -> None:
        """Right of a point."""
        ((column, row),) = self.at(np.array([x_m]), np.array([y_m]))
        place = (int(column) + 6, int(row) + 5)
        cv2.putText(self.image, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.45, colour, 1, cv2.LINE_AA)


def _draw_lanes(canvas: _Canvas, zones: LidarZones, config: LidarConfig) -> None:
    half, side, ahead = config.zones.centre_width_m / 2, config.zones.side_width_m, config.zones.look_ahead_m
    edges = {"left": (half + side, half), "centre": (half, -half), "right": (-half, -half - side)}
    for lane in LANES:
        zone = getattr(zones, lane)
        left, right = edges[lane]
        canvas.box([(0, left), (ahead, left), (ahead, right), (0, right)], GREY, 1)
        if zone.nearest_m is not None:
            canvas.box([(zone.nearest_m, left), (zone.nearest_m, right)], LEVEL_COLOURS[zone.level], 4)
    for limit_m, level in ((config.zones.imminent_m, "IMMINENT"), (config.zones.caution_m, "CAUTION")):
        canvas.box([(limit_m, half + side), (limit_m, -half - side)], LEVEL_COLOURS[level], 1)
        canvas.say(f"{level} up to {limit_m:g} m", limit_m, -half - side, GREY)
    canvas.say(f"{ahead:g} m", ahead, -half - side, GREY)
    wide, long = config.mounting.vehicle_width_m / 2, config.mounting.vehicle_length_m
    canvas.box([(0, wide), (0, -wide), (-long, -wide), (-long, wide)], (0, 0, 0), 2)


def _draw_cone(canvas: _Canvas, config: LidarConfig) -> None:
    half_rad, reach_m = np.radians(config.zones.fov_deg / 2), config.zones.look_ahead_m
    x, y, front_m = reach_m * np.cos(half_rad), reach_m * np.sin(half_rad), config.mounting.front_m
    for side in (y, -y):
        canvas.box(
            [(-front_m, config.mounting.left_m), (x - front_m, side + config.mounting.left_m)], (230, 200, 160), 1
        )


def _draw_text(image: np.ndarray, reject_reason: np.ndarray, zones: LidarZones) -> None:
    lanes = []
    for lane in LANES:
        zone = getattr(zones, lane)
        lanes.append(f"{lane} " + ("free" if zone.nearest_m is None else f"{zone.nearest_m:.2f} m"))
    _line(image, 0, f"{zones.level}   " + "   ".join(lanes), LEVEL_COLOURS[zones.level])
    _line(image, 1, f"{zones.state}: {zones.reason}" if zones.reason else zones.state, (0, 0, 0))
    column = 10
    for kind, colour in COLOURS.items():
        text = f"{kind.name.lower()} {np.count_nonzero(reject_reason == kind)}"
        cv2.circle(image, (column + 4, 82), 5, colour, -1, cv2.LINE_AA)
        cv2.putText(image, text, (column + 14, 87), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 1, cv2.LINE_AA)
        column += 30 + 9 * len(text)


def _line(image: np.ndarray, number: int, text: str, colour: tuple[int, int, int]) -> None:
    place = (10, 28 + 28 * number)
    cv2.putText(image, text[:120], place, cv2.FONT_HERSHEY_SIMPLEX, 0.7 - 0.2 * number, colour, 1, cv2.LINE_AA)
