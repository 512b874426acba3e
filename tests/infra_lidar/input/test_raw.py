"""A recording of raw bytes over restarts of the service: each piece is decoded with its own sensor and calibration."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from common.codec import encode
from common.messages import RawBytes
from common.recording.file import RecordingFile
from common.source_url import SourceUrl
from services.infra_lidar.input.models import decoder_of
from services.infra_lidar.input.ouster import OusterFormat
from services.infra_lidar.input.raw import recorded_frames
from services.infra_lidar.input.revolution import decode_revolution, stack_packets
from tests.infra_lidar.made_packets import metadata, ouster_packet, vls_packet

LEVEL = metadata()
TILTED = metadata(beam_altitude_angles=[15.0, -5.0, -15.0, -25.0])
OUSTER = [ouster_packet(OusterFormat(LEVEL), 1, column) for column in range(0, 64, 16)]
VELODYNE = [vls_packet(0.6 * k, time_us=166 * k) for k in range(10)]


def test_another_sensor_or_calibration_gets_its_own_decoder(tmp_path: Path) -> None:
    turns = [("ouster", LEVEL, OUSTER), ("ouster", TILTED, OUSTER), ("velodyne", "", VELODYNE)] * 2
    with RecordingFile(tmp_path / "a.mcap", {}) as file:
        for k, (kind, text, packets) in enumerate(turns):
            piece = RawBytes(
                stamp_ns=k + 1, received_ns=0, kind=kind, index=0, epoch=0, data=stack_packets(packets),
                about={"metadata": text},
            )  # fmt: skip
            file.add("infra0/infra_lidar/raw", RawBytes, encode(piece), piece.stamp_ns, 0, k)
    frames = [frame for _, frame in recorded_frames(SourceUrl("mcap", str(tmp_path / "a.mcap"), {"rate": "0"}))]
    assert len(frames) == len(turns)
    for frame, (kind, text, packets) in zip(frames, turns, strict=True):
        expected = decode_revolution(stack_packets(packets), decoder_of(kind, text)).points
        np.testing.assert_array_equal(frame.points, expected)
