"""What holds of every decoder: other sensors' packets are refused, random bytes too, and a live port gives turns."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.bus.look import Look
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.input.hesai_calibration import as_metadata
from services.infra_lidar.input.models import KINDS, decoder_of
from services.infra_lidar.input.robosense import unknown_angles
from services.infra_lidar.look import looks
from tests.infra_lidar import hesai_packets, ouster_packets, robosense_packets
from tests.infra_lidar.made_packets import sending, vls_packet

OUSTER = ouster_packets.metadata("RNG15_RFL8_NIR8")
METADATA = {
    "velodyne": "",
    "ouster": OUSTER,
    "hesai": as_metadata(hesai_packets.ANGLES),
    "robosense": unknown_angles(),
}
FRAME = ouster_packets.Frame(
    "RNG15_RFL8_NIR8", np.full((1, 128, ouster_packets.COLUMNS), 1000), np.full((1, 128, ouster_packets.COLUMNS), 9)
)
PACKETS = {
    "velodyne": vls_packet(10.0),
    "ouster": FRAME.packet(0),
    "hesai": hesai_packets.Packet().build(),
    "hesai, QT128": hesai_packets.Packet(qt128=True).build(),
    "robosense": robosense_packets.Msop().build(),
    "robosense, Plus": robosense_packets.Msop(plus=True).build(),
    "robosense's DIFOP": robosense_packets.difop(),
}


def test_every_kind_is_here() -> None:
    assert set(METADATA) == set(KINDS)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("sent", PACKETS)
def test_packets_of_other_sensors_are_refused(kind: str, sent: str) -> None:
    parser = KINDS[kind].parser(METADATA[kind], 0.0)
    own = sent.partition(",")[0] == kind
    assert parser.accepts(PACKETS[sent]) == own
    parser.feed(PACKETS[sent], 1)
    assert parser.rejected == (0 if own else 1)
    assert (parser.assembler.finish() is None) == (not own)


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(sorted(KINDS)),
    st.sampled_from([0, 1, 11, 861, 1206, 1248, 8448]),
    st.randoms(use_true_random=False),
)
def test_random_bytes_are_no_packets(kind: str, size: int, random: object) -> None:
    packet = random.randbytes(size)  # type: ignore[attr-defined]
    parser = KINDS[kind].parser(METADATA[kind], 0.0)
    parser.feed(packet, 1)
    assert parser.rejected == 1
    assert parser.assembler.finish() is None


@pytest.mark.parametrize("kind", KINDS)
def test_a_decoder_takes_packets_of_zeros_and_of_ones(kind: str) -> None:
    decoder = decoder_of(kind, METADATA[kind])
    size = len(PACKETS[kind])
    for value in (0, 255):
        image = decoder.decode(np.full((3, size), value, np.uint8))
        assert np.isfinite(image.points).all()
    assert len(decoder.decode(np.zeros((0, size), np.uint8))) == 0


def test_an_unknown_kind_is_said() -> None:
    with pytest.raises(KeyError, match="expected a sensor of"):
        decoder_of("livox", "")
    with pytest.raises(ValueError, match="not the angles"):
        decoder_of("robosense", json.dumps({}))


@pytest.mark.parametrize("kind", ["hesai", "robosense"])
def test_a_live_port_gives_turns(kind: str, tmp_path: Path, free_ports: Callable[[], int]) -> None:
    port = free_ports()
    angles = tmp_path / "angles.csv"
    if kind == "hesai":
        angles.write_text(hesai_packets.ANGLES)
        packets = [
            hesai_packets.Packet(sequence=k, azimuth=(600 * k % 36000, (600 * k + 20) % 36000)).build()
            for k in range(600)
        ]
    else:
        angles.write_text("".join(f"{v},0\n" for v in robosense_packets.VERTICAL_DEG))
        places = [(600 * k % 36000, (600 * k + 20) % 36000, (600 * k + 40) % 36000) for k in range(600)]
        packets = [robosense_packets.Msop(azimuth=at, microsecond=167 * k).build() for k, at in enumerate(places)]
    with sending(packets, port):
        seen: Look = next(looks(InfraLidarConfig(source=f"{kind}://127.0.0.1?port={port}&calibration={angles}"), 0.5))
    assert seen.sees, seen
    assert "packets per revolution" in seen.what
