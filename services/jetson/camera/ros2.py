"""``ros2:/image?type=...``: pictures of any camera with a ROS 2 driver. The mapping is pure; ``ros_pictures`` opens a
session."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from functools import partial
from typing import Any

import cv2
import numpy as np

from common.bus.status import Report
from common.config import ZenohConfig
from common.ros2.reader import TopicReader
from common.ros2.source import ros_session, ros_topic
from common.source_url import SourceUrl
from services.jetson.camera.frames import Frame, Source

RAW, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
TYPES = (RAW, COMPRESSED)
NODE = "spotter_camera"
LARGEST_SIDE_PX = 16384
# By sensor_msgs/image_encodings: bytes of a pixel, and the way to BGR; None = it is that.
ENCODINGS: dict[str, tuple[int, int | None]] = {
    "bgr8": (3, None),
    "8UC3": (3, None),
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    "bgra8": (4, cv2.COLOR_BGRA2BGR),
    "rgba8": (4, cv2.COLOR_RGBA2BGR),
    "mono8": (1, cv2.COLOR_GRAY2BGR),
    "8UC1": (1, cv2.COLOR_GRAY2BGR),
    "yuv422": (2, cv2.COLOR_YUV2BGR_UYVY),
    "uyvy": (2, cv2.COLOR_YUV2BGR_UYVY),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2BGR_YUY2),
    "yuyv": (2, cv2.COLOR_YUV2BGR_YUY2),
    "bayer_rggb8": (1, cv2.COLOR_BayerRGGB2BGR),
    "bayer_bggr8": (1, cv2.COLOR_BayerBGGR2BGR),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGBRG2BGR),
    "bayer_grbg8": (1, cv2.COLOR_BayerGRBG2BGR),
}


class PictureError(ValueError):
    """A picture that cannot be read; the text says why."""


def picture_of(message: Any, type_: str) -> np.ndarray:
    """(H, W, 3) uint8 BGR of a sensor_msgs/Image or CompressedImage.

    Raises:
        PictureError: an encoding that is not read, sizes that contradict each other, or damaged data.
    """
    try:
        return _raw(message) if type_ == RAW else _compressed(message)
    except cv2.error as error:  # an odd width in pairs of pixels, or more pixels than OpenCV decodes
        raise PictureError(f"{_announced(message)}: OpenCV refuses it: {error.err}") from None


def _announced(message: Any) -> str:
    if hasattr(message, "encoding"):
        return f"{message.width} x {message.height} pixels of encoding {message.encoding!r}"
    return f"{len(message.data)} bytes of format {message.format!r}"


def _raw(message: Any) -> np.ndarray:
    if message.encoding not in ENCODINGS:
        raise PictureError(f"encoding {message.encoding!r} is not read; those are: {', '.join(ENCODINGS)}")
    size, code = ENCODINGS[message.encoding]
    height, width, step = int(message.height), int(message.width), int(message.step)
    if not (2 <= height <= LARGEST_SIDE_PX and 2 <= width <= LARGEST_SIDE_PX):
        raise PictureError(f"{width} x {height} pixels")
    if step < width * size:
        raise PictureError(f"a row of {width} pixels of {size} bytes has {step} bytes")
    data = np.asarray(message.data, np.uint8)
    if len(data) < step * (height - 1) + width * size:
        raise PictureError(f"{height} rows of {step} bytes are announced, {len(data)} bytes follow")
    pixels = np.ndarray((height, width, size), np.uint8, np.ascontiguousarray(data), strides=(step, size, 1))
    if code is None:
        return pixels.copy()
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(pixels[..., 0] if size == 1 else pixels), code), np.uint8)


def _compressed(message: Any) -> np.ndarray:
    if "compressedDepth" in message.format:
        raise PictureError(f"format {message.format!r} is a depth, no picture")
    data = np.asarray(message.data, np.uint8)
    picture = cv2.imdecode(data, cv2.IMREAD_COLOR) if len(data) else None
    if picture is None:
        raise PictureError(f"{len(data)} bytes of format {message.format!r} are no picture that can be decoded")
    return np.asarray(picture, np.uint8)


def ros_pictures(url: SourceUrl, zenoh: ZenohConfig, report: Report) -> Source:
    """A source for ``NewestFrames``. Raises ``ConfigError``: a wrong address."""
    topic = ros_topic(url, TYPES)
    return partial(_pictures, TopicReader(topic, ros_session(url, zenoh), report, NODE))


def _pictures(reader: TopicReader, stop: threading.Event) -> Iterator[Frame]:
    with reader:
        for arrived in reader.messages(stop):
            try:
                image = picture_of(arrived.message, reader.topic.type)
            except PictureError as error:
                reader.refuse(str(error), "unreadable picture")
                continue
            yield Frame(arrived.stamp_ns, arrived.received_ns, image)
