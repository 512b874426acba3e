"""A camera that is mounted on its side, upside down or behind a mirror: everything behind the source sees upright."""

from __future__ import annotations

import itertools
import threading
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from common.bus.status import Report
from services.jetson.camera.config import CameraConfig, CaptureConfig, LensConfig
from services.jetson.camera.detector import DEMO_MODEL
from services.jetson.camera.pipeline import CameraPipeline
from services.jetson.camera.source import fitted, open_source
from services.jetson.camera.upright import lens_of_upright, upright
from spotter_sim import camera as simulated

TURNS, FLIPS = (0, 90, 180, 270), ("none", "horizontal", "vertical")


def mounted(image: np.ndarray, rotate_deg: int, flip: str) -> np.ndarray:
    """What a camera delivers whose picture has to be turned and flipped so to be upright."""
    if flip != "none":
        image = image[:, ::-1] if flip == "horizontal" else image[::-1]
    return np.ascontiguousarray(np.rot90(image, rotate_deg // 90))  # counter-clockwise


@pytest.mark.parametrize(("rotate_deg", "flip"), [*itertools.product(TURNS, FLIPS)])
def test_any_mounting_gives_the_upright_picture(rotate_deg: int, flip: str) -> None:
    image = np.random.default_rng(1).integers(0, 256, (48, 64, 3), np.uint8)
    config = msgspec.convert({"rotate_deg": rotate_deg, "flip": flip}, CaptureConfig)
    assert np.array_equal(upright(mounted(image, rotate_deg, flip), config), image)


@pytest.mark.parametrize(("rotate_deg", "flip"), [(180, "none"), (90, "none"), (270, "horizontal")])
def test_a_turned_camera_sees_and_measures_what_an_upright_one_does(
    tmp_path: Path, report: Report, rotate_deg: int, flip: str
) -> None:
    """Through the source and the pipeline: the boxes, distances, zone and strips of the upright picture."""
    image = simulated.image("crossing", 6.0)
    cv2.imwrite(str(tmp_path / "still.png"), mounted(image, rotate_deg, flip))
    asked = {
        "source": f"file:{tmp_path / 'still.png'}?rate=0",
        "detector": {"model": str(DEMO_MODEL)},
        "capture": {"rotate_deg": rotate_deg, "flip": flip},
    }
    config = fitted(msgspec.convert(asked, CameraConfig))
    source, _ = open_source(config, report)
    frame = next(source(threading.Event()))
    seen, plain = CameraPipeline(config).process(0, frame.image), CameraPipeline(config).process(0, image)
    assert seen.detections
    assert (seen.detections, seen.strips_see, seen.image_size_px) == (plain.detections, plain.strips_see, (640, 480))


def test_the_simulated_world_is_upright_already(report: Report) -> None:
    config = CameraConfig(source="sim:crossing", capture=CaptureConfig(rotate_deg=90))
    source, _ = open_source(config, report)
    assert next(source(threading.Event())).image.shape == (480, 640, 3)


@pytest.mark.parametrize("rotate_deg", [90, 270])
def test_a_lens_from_before_a_quarter_turn_is_turned_with_the_picture(rotate_deg: int) -> None:
    """Points through lens and distortion, then turned, are the turned points through the turned lens."""
    lens = LensConfig(f_x_px=410.0, f_y_px=390.0, c_x_px=300.0, c_y_px=250.0, distortion=(-0.3, 0.1, 0.01, -0.02, 0.01))
    capture = msgspec.convert({"rotate_deg": rotate_deg}, CaptureConfig)
    turned = lens_of_upright(lens, capture, 480, 640)
    assert (turned.width_px, turned.height_px) == (480, 640)
    points = np.random.default_rng(2).uniform((-1, -1, 2), (1, 1, 5), (20, 3))
    x, y, z = points.T
    pixels = project(points, lens)
    if rotate_deg == 90:
        expected, moved = np.column_stack([480 - pixels[:, 1], pixels[:, 0]]), np.column_stack([-y, x, z])
    else:
        expected, moved = np.column_stack([pixels[:, 1], 640 - pixels[:, 0]]), np.column_stack([y, -x, z])
    assert project(moved, turned) == pytest.approx(expected)


def test_a_lens_that_was_measured_upright_stays() -> None:
    lens, sideways = LensConfig(width_px=480, height_px=640, c_x_px=240.0, c_y_px=320.0), CaptureConfig(rotate_deg=90)
    assert lens_of_upright(lens, sideways, 480, 640) is lens
    assert lens_of_upright(LensConfig(), CaptureConfig(rotate_deg=180), 640, 480) == LensConfig()
    assert lens_of_upright(LensConfig(), CaptureConfig(), 480, 640) == LensConfig()  # columns were cut off


def project(points: np.ndarray, lens: LensConfig) -> np.ndarray:
    matrix = np.array([[lens.f_x_px, 0, lens.c_x_px], [0, lens.f_y_px, lens.c_y_px], [0, 0, 1.0]])
    return cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array(lens.distortion))[0].reshape(-1, 2)
