"""Collective Perception Messages read and written again by another ASN.1 compiler, pycrate, from the same module."""

from __future__ import annotations

import importlib
import importlib.util
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("asn1tools", reason="needs the cpm extra")
pytest.importorskip("pycrate_asn1c", reason="needs pycrate")

from common.geodesy import MapOrigin
from common.messages import ObjectTrack, ObjectTracks
from spotter_tools.cpm.codec import CONTAINERS, MODULE, decode, encode
from spotter_tools.cpm.message import MAX_OBJECTS, messages_of

ORIGIN = MapOrigin(latitude_deg=52.5163, longitude_deg=-13.3777, altitude_m=41.5, heading_deg=30.0)
LABELS = ("car", "large_vehicle", "pedestrian", "cyclist", "unknown")


@pytest.fixture(scope="module")
def pycrate(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Our module as pycrate's classes."""
    path = tmp_path_factory.mktemp("pycrate") / "cpm_by_pycrate.py"
    compiler = importlib.import_module("pycrate_asn1c.asnproc")
    writer = importlib.import_module("pycrate_asn1c.generator").PycrateGenerator
    compiler.compile_text(MODULE.read_text())
    compiler.generate_modules(writer, str(path))
    return loaded(path).Spotter_CPM


def loaded(path: Path) -> Any:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def reread(pycrate: Any, type_: str, data: bytes) -> Any:
    """The content as pycrate reads it; it writes the same bytes."""
    one = getattr(pycrate, type_)
    one.from_uper(data)
    content = one.get_val()
    assert one.to_uper() == data
    return content


def street(count: int) -> ObjectTracks:
    """Everything that a track may say, spread over its ranges and beyond."""
    found = [
        ObjectTrack(
            track_id=9 * k, label=LABELS[k % 5], label_confidence=k / max(1, count - 1),
            position_m=(80.0 * k - 900.0, 37.0 * k, 0.1 * k), velocity_mps=(2.0 * k - 20.0, -3.0 * k, 0.0),
            covariance=[[10.0 ** (k - 8) * (i == j) for j in range(6)] for i in range(6)],
            size_m=(0.3 + k, 0.5 + 0.1 * k, 1.0 + 0.2 * k), yaw_rad=0.4 * k - 3.0, age_s=0.3 * k, score=k / 40,
            state="confirmed", points=9,
        )
        for k in range(count)
    ]  # fmt: skip
    return ObjectTracks(stamp_ns=1_790_000_000_123_000_000, tracks=found, frame_id="map", source_kind="live")


@pytest.mark.parametrize("count", [0, 1, 5, MAX_OBJECTS, MAX_OBJECTS + 5])
def test_pycrate_reads_and_writes_what_we_send(pycrate: Any, count: int) -> None:
    for content in messages_of(street(count), ORIGIN, 4711):
        data = encode(content)
        message, ours = reread(pycrate, "CollectivePerceptionMessage", data), decode(data)
        assert message["header"] == ours["header"] == content["header"]
        assert message["payload"]["managementContainer"] == ours["managementContainer"]
        containers = {
            one["containerId"]: reread(pycrate, CONTAINERS[one["containerId"]], one["containerData"])
            for one in message["payload"]["cpmContainers"]
        }
        assert containers == ours["containers"]
