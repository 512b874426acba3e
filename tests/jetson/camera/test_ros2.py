"""Pictures of a ROS 2 driver: the mapping, and the source over a real router."""

from __future__ import annotations

import threading
from typing import Any

import cv2
import numpy as np
import pytest

from common.bus.session import open_session
from common.bus.status import Report
from common.clock import utc_ns
from common.config import ZenohConfig
from common.ros2.keys import SENSOR_DATA
from common.ros2.node import Node
from common.ros2.types import build, header
from services.jetson.camera.config import CameraConfig
from services.jetson.camera.frames import Frame
from services.jetson.camera.ros2 import COMPRESSED, ENCODINGS, RAW, PictureError, picture_of
from services.jetson.camera.source import open_source

RED = np.zeros((6, 8, 3), np.uint8)
RED[..., 2] = 200
# The head of a PNG that announces 200000 x 200000 pixels, with an empty body.
HUGE_PNG = bytes.fromhex("89504e470d0a1a0a0000000d4948445200030d4000030d40080200000076591f5d000000004944415435af061e")


def image(encoding: str, pixels: np.ndarray, padding: int = 0, **fields: Any) -> Any:
    rows = pixels.reshape(len(pixels), -1)
    step = rows.shape[1] + padding
    data = np.full((len(rows), step), 0xAB, np.uint8)
    data[:, : rows.shape[1]] = rows
    about = {"height": len(rows), "width": pixels.shape[1], "step": step, "encoding": encoding, "data": data.ravel()}
    return build(RAW, **(about | fields))


@pytest.mark.parametrize("padding", [0, 5])
@pytest.mark.parametrize(
    ("encoding", "pixels"),
    [
        ("bgr8", RED),
        ("rgb8", RED[..., ::-1]),
        ("bgra8", cv2.cvtColor(RED, cv2.COLOR_BGR2BGRA)),
        ("rgba8", cv2.cvtColor(RED, cv2.COLOR_BGR2RGBA)),
    ],
)
def test_colours_and_rows_come_out_right(encoding: str, pixels: np.ndarray, padding: int) -> None:
    np.testing.assert_array_equal(picture_of(image(encoding, pixels, padding), RAW), RED)


def test_grey_yuv_and_bayer() -> None:
    grey = np.arange(48, dtype=np.uint8).reshape(6, 8)
    np.testing.assert_array_equal(picture_of(image("mono8", grey), RAW), np.repeat(grey[..., None], 3, axis=2))
    yuyv = np.tile(np.array([[[81, 90], [81, 240]]], np.uint8), (6, 4, 1))  # red of ITU-R BT.601
    for encoding, pixels in (("yuv422_yuy2", yuyv), ("uyvy", yuyv[..., ::-1])):
        blue, green, red = picture_of(image(encoding, pixels), RAW)[2, 2].tolist()
        assert red > 240
        assert max(blue, green) < 20
    mosaic = np.zeros((6, 8), np.uint8)
    mosaic[0::2, 0::2] = 200  # only the red cells of RGGB are lit
    b, g, r = picture_of(image("bayer_rggb8", mosaic), RAW)[2:4, 2:6].reshape(-1, 3).mean(axis=0)
    assert r > 150 > 100 > max(b, g)


def test_every_encoding_gives_a_picture_of_its_size() -> None:
    for encoding, (size, _) in ENCODINGS.items():
        pixels = np.full((6, 8, size), 90, np.uint8)
        assert picture_of(image(encoding, pixels), RAW).shape == (6, 8, 3)


def test_a_compressed_picture() -> None:
    data = cv2.imencode(".png", RED)[1].ravel()
    np.testing.assert_array_equal(picture_of(build(COMPRESSED, format="bgr8; png", data=data), COMPRESSED), RED)


@pytest.mark.parametrize(
    ("message", "type_", "words"),
    [
        (image("mono16", RED), RAW, "encoding 'mono16' is not read; those are: bgr8"),
        (image("bgr8", RED, step=10), RAW, "a row of 8 pixels of 3 bytes has 10 bytes"),
        (image("bgr8", RED, height=7), RAW, "7 rows of 24 bytes are announced, 144 bytes follow"),
        (image("bgr8", RED, width=0), RAW, "0 x 6 pixels"),
        (image("uyvy", RED[:, :7, :2]), RAW, "7 x 6 pixels of encoding 'uyvy': OpenCV refuses it: .*width % 2"),
        (
            build(COMPRESSED, format="png", data=list(HUGE_PNG)),
            COMPRESSED,
            f"{len(HUGE_PNG)} bytes of format 'png': OpenCV",
        ),
        (build(COMPRESSED, format="jpeg", data=[1, 2, 3]), COMPRESSED, "3 bytes of format 'jpeg' are no picture"),
        (build(COMPRESSED, format="jpeg"), COMPRESSED, "0 bytes of format"),
        (build(COMPRESSED, format="32FC1; compressedDepth png", data=[1]), COMPRESSED, "is a depth, no picture"),
    ],
)
def test_what_is_no_picture_is_refused_with_what_was_found(message: Any, type_: str, words: str) -> None:
    with pytest.raises(PictureError, match=words):
        picture_of(message, type_)


def test_pictures_come_from_a_driver(router_endpoint: str, until) -> None:
    config = CameraConfig(source="ros2:/image", zenoh=ZenohConfig(namespace="site", connect=(router_endpoint,)))
    report, frames, stop = Report("camera"), list[Frame](), threading.Event()
    source, lossless = open_source(config, report)
    assert not lossless
    thread = threading.Thread(target=lambda: frames.extend(source(stop)), daemon=True)
    thread.start()
    with open_session(ZenohConfig(namespace="", connect=(router_endpoint,))) as session:
        publish = Node(session, "driver").publisher("/image", RAW, SENSOR_DATA)
        until(lambda: publish.wanted)

        def deep_is_told() -> bool:
            publish(image("mono16", RED, header=header(utc_ns(), "camera")))
            return "encoding 'mono16' is not read" in report.snapshot().reason

        until(deep_is_told)
        stamp_ns = utc_ns()
        publish(image("bgr8", RED, header=header(stamp_ns, "camera")))
        until(lambda: frames)
    assert frames[0].stamp_ns == stamp_ns
    np.testing.assert_array_equal(frames[0].image, RED)
    stop.set()
    thread.join(10.0)
    assert not thread.is_alive()
