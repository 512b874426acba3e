"""What Foxglove is given: its own messages with its own schemas, in a file that the official reader finds sound."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from common import messages as m
from common.codec import decode, encode
from common.messages import Verdict
from common.recording.file import RecordingFile

foxglove = pytest.importorskip("common.recording.foxglove", reason="needs the extra foxglove")
T = 1_700_000_000_000_000_000
SOME, BYTES = np.array([0.5, 1.0], np.float32), np.zeros(2, np.uint8)
SHOWN = {
    "jetson0/lidar/scan": (
        m.LaserScan(stamp_ns=T, angles_rad=SOME, ranges_m=SOME, confidence=BYTES),
        "foxglove.PointCloud",
    ),
    "infra0/infra_lidar/points": (
        m.PointCloud(stamp_ns=T, points=np.zeros((2, 3), np.float32), intensity=BYTES, kind=BYTES),
        "foxglove.PointCloud",
    ),
    "jetson0/camera/image": (
        m.CompressedImage(stamp_ns=T, format="jpeg", data=b"\xff\xd8\xff"),
        "foxglove.CompressedImage",
    ),
    "infra0/infra_lidar/tracks": (m.ObjectTracks(stamp_ns=T, tracks=[]), "foxglove.SceneUpdate"),
    "pi0/radar/tracks": (
        m.RadarTracks(stamp_ns=T, tracks=[], level="SAFE", settled=True, noise_floor_db=-60.0),
        "foxglove.SceneUpdate",
    ),
    "jetson0/ego/motion": (
        m.EgoMotion(stamp_ns=T, speed_mps=1.0, yaw_rate_radps=0.0, T_map_vehicle=np.eye(4).tolist()),
        "foxglove.FrameTransform",
    ),
}


def test_a_verdict_is_a_line_of_the_log(verdict: Callable[..., Verdict]) -> None:
    ((name, log),) = foxglove.convert("jetson0/fusion/verdict", verdict(10**18))
    assert name == "/foxglove/jetson0/fusion/verdict"
    assert type(log).get_schema().name == "foxglove.Log"


def test_the_file_carries_foxgloves_own_schemas_and_is_sound(tmp_path: Path) -> None:
    """Name, encoding and every byte of the schema are those of Foxglove's SDK; CRCs, index and counts agree."""
    path = tmp_path / "a.mcap"
    with RecordingFile(path, {}) as file:
        for key, (message, _) in SHOWN.items():
            file.add(key, type(message), encode(message), T, 0, 0)
            for name, converted in foxglove.convert(key, message):
                file.add_foxglove(name, converted, T, T)
                file.flush()
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        read_back = list(reader.iter_messages())
    own = [(schema, channel) for schema, channel, _ in read_back if channel.message_encoding == "protobuf"]
    expected = {name for _, name in SHOWN.values()}
    assert {schema.name for schema, _ in own if schema} == expected
    for schema, _ in own:
        assert schema is not None
        real = getattr(foxglove.fg, schema.name.removeprefix("foxglove.")).get_schema()
        assert (schema.encoding, schema.data) == (real.encoding, real.data)
    statistics = summary.statistics
    assert statistics.message_count == len(read_back) == sum(statistics.channel_message_counts.values())
    assert statistics.chunk_count == len(summary.chunk_indexes)
    assert statistics.schema_count == len(summary.schemas)
    assert statistics.channel_count == len(summary.channels)
    indexed = sum(sum(1 for _ in index.message_index_offsets) for index in summary.chunk_indexes)
    assert indexed >= len(summary.channels)


def test_every_kind_of_message_that_can_be_drawn_is_drawn() -> None:
    for key, (message, name) in SHOWN.items():
        assert {type(converted).get_schema().name for _, converted in foxglove.convert(key, message)} == {name}, key


@pytest.mark.parametrize("key", SHOWN)
def test_a_stamp_after_foxgloves_last_second_ends_neither_recorder_nor_bridge(key: str) -> None:
    message = decode(encode(SHOWN[key][0]), type(SHOWN[key][0]))
    message.stamp_ns = 2**64 - 1  # the greatest that a message may carry
    ((_, converted),) = foxglove.convert(key, message)
    assert isinstance(converted.encode(), bytes)
