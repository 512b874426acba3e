"""camera.toml lists every key with its default; wrong values are refused with words."""

from __future__ import annotations

import tomllib
from pathlib import Path

import msgspec
import pytest

from common.config import ConfigError, load
from services.jetson.camera import config as module
from services.jetson.camera.config import CameraConfig

SHIPPED = Path(module.__file__).with_name("camera.toml")


def test_the_shipped_file_is_the_defaults() -> None:
    assert load(CameraConfig, SHIPPED) == CameraConfig()


def test_the_shipped_file_names_every_key() -> None:
    expected = msgspec.json.decode(msgspec.json.encode(CameraConfig()))  # tuples as lists
    del expected["zenoh"]["extra"]  # free-form
    assert tomllib.loads(SHIPPED.read_text()) == expected


def test_another_network_is_one_key() -> None:
    assert load(CameraConfig, overrides=["detector.model=yolov8n.onnx"]).detector.model == "yolov8n.onnx"


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("detector.confidence=1.5", "<= 1.0"),
        ("detector.modle=x.onnx", "did you mean 'model'"),
        ("detector.providers=['Gpu']", "Gpu"),
        ("zone.imminent_m=2.0", "imminent_m must not exceed caution_m"),
        ("zone.imminent_height=0.5", "imminent_height must not be below"),
        ("capture.width_px=642", "multiple of 4"),
        ("capture.retry_min_s=9.0", "retry_min_s must not exceed"),
        ("distance.sizes={}", "must name at least one class"),
        ("distance.sizes.person.height_m=-1.0", "height_m"),
    ],
)
def test_wrong_values_are_refused(override: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load(CameraConfig, overrides=[override])


def test_a_class_of_ones_own_is_checked_like_every_other_key() -> None:
    kangaroo = "distance.sizes.kangaroo={height_m=1.5,height_sigma_m=0.2,width_m=0.6}"
    assert load(CameraConfig, overrides=[kangaroo]).distance.sizes["kangaroo"].height_m == 1.5
    with pytest.raises(ConfigError, match=r"\[distance.sizes.kangaroo\] hight_m.*did you mean 'height_m'"):
        load(CameraConfig, overrides=[kangaroo.replace("height_m=", "hight_m=")])


@pytest.mark.parametrize("source", ["csi:0", "v4l2:/dev/video0", "file:street.mp4"])
def test_the_demo_network_is_for_the_simulated_world_alone(source: str) -> None:
    with pytest.raises(ConfigError, match=r'\[detector\] model = "".*yolo export'):
        load(CameraConfig, overrides=[f'source="{source}"'])
    assert load(CameraConfig, overrides=[f'source="{source}"', 'detector.model="yolo11n.onnx"']).source == source
    assert load(CameraConfig, overrides=['source="sim:crossing"']).detector.model == ""
