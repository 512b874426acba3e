"""Where data come from is told by the source URL, in one place, and what is not known is never called live."""

from __future__ import annotations

import importlib
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.messages import SOURCE_KINDS, LidarZone, LidarZones, SourceKind, least_live
from common.source_url import source_kind


@pytest.mark.parametrize(
    ("source", "kind"),
    [
        ("sim:crossing", "simulated"),
        ("sim:crossing?t0=3", "simulated"),
        ("file:street.mp4?loop=1", "recorded"),
        ("file:/data/emulator", "recorded"),
        ("mcap:drive.mcap", "recorded"),
        ("spi:emulator", "emulated"),
        ("spi:0.0", "live"),
        ("serial:/dev/ttyTHS1", "live"),
        ("serial:///dev/serial/by-id/usb-0001", "live"),
        ("v4l2:0", "live"),
        ("csi:0", "live"),
        ("velodyne://:2368", "live"),
        ("ouster://os-1.local", "live"),
        ("", "unknown"),
        ("crossing", "unknown"),
        ("rtsp://camera", "unknown"),
    ],
)
def test_the_kind_of_a_source(source: str, kind: SourceKind) -> None:
    assert source_kind(source) == kind


@pytest.mark.parametrize(
    "module",
    ["jetson.ego.source", "radar_pi.source", "jetson.lidar.source", "jetson.camera.source", "infra_lidar.input.source"],
)
def test_every_scheme_of_every_sensor_has_a_kind(module: str) -> None:
    schemes = importlib.import_module(f"services.{module}").SCHEMES
    assert {scheme: source_kind(f"{scheme}:x") for scheme in schemes if source_kind(f"{scheme}:x") == "unknown"} == {}


def test_a_message_that_does_not_say_is_not_live() -> None:
    free = LidarZone(nearest_m=None, points=0, level="SAFE")
    zones = LidarZones(stamp_ns=1, left=free, centre=free, right=free, level="SAFE", raw_level="SAFE")
    assert zones.source_kind == "unknown"


@given(st.lists(st.sampled_from(SOURCE_KINDS), min_size=1))
def test_only_live_inputs_make_something_live(kinds: list[SourceKind]) -> None:
    assert (least_live(kinds) == "live") == (set(kinds) == {"live"})
    assert least_live([*kinds, "unknown"]) == "unknown"


def test_nothing_at_all_is_not_live() -> None:
    assert least_live([]) == "unknown"
    assert get_args(SourceKind) == SOURCE_KINDS
