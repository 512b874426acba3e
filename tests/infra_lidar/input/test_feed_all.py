"""Packets that come many at a time give what they give one by one, whatever has happened to them on the way."""

from __future__ import annotations

from functools import cache
from itertools import accumulate, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.infra_lidar.input import robosense
from services.infra_lidar.input.hesai_calibration import as_metadata
from services.infra_lidar.input.models import KINDS
from services.infra_lidar.input.ouster import OusterFormat
from services.infra_lidar.input.revolution import Revolution
from services.infra_lidar.input.spinning import PacketParser
from tests.infra_lidar.hesai_packets import ANGLES
from tests.infra_lidar.hesai_packets import Packet as HesaiPacket
from tests.infra_lidar.made_packets import metadata, ouster_packet, vls_packet
from tests.infra_lidar.robosense_packets import Msop

METADATA = {
    "velodyne": "", "hesai": as_metadata(ANGLES), "robosense": robosense.unknown_angles(), "ouster": metadata(),
}  # fmt: skip
STEP_DEG = 1.1  # from one packet to the next: turns of few packets


@cache
def turns(kind: str) -> list[bytes]:
    """Two turns of the head and some packets more; of the Ouster 60 turns of 4."""
    if kind == "ouster":
        layout = OusterFormat(metadata())
        return [ouster_packet(layout, k // 4, 16 * (k % 4)) for k in range(240)]
    return [one_packet(kind, k) for k in range(700)]


def one_packet(kind: str, k: int) -> bytes:
    """The packet of number k."""
    hundredths = round(100 * STEP_DEG * k) % 36000
    if kind == "velodyne":
        return vls_packet(hundredths / 100, time_us=166 * k)
    if kind == "hesai":
        return HesaiPacket(azimuth=(hundredths, hundredths + 20), sequence=k).build()
    return Msop(azimuth=(hundredths, hundredths + 20, hundredths + 40), microsecond=167 * k).build()


def counted(parser: PacketParser) -> tuple[int, dict[str, int]]:
    return parser.rejected, dict(parser.order.counters)


def assert_same(a: list[Revolution], b: list[Revolution]) -> None:
    for one, other in zip(a, b, strict=True):
        assert (one.stamp_ns, one.quality, one.packets) == (other.stamp_ns, other.quality, other.packets)
        np.testing.assert_array_equal(one.points, other.points)


disturbances = st.lists(
    st.tuples(
        st.sampled_from(["lost", "doubled", "swapped", "late", "foreign", "cut", "window", "restart"]),
        st.integers(0, 650),
        st.integers(1, 30),
    ),
    max_size=6,
)


def disturbed(packets: list[bytes], what: str, at: int, n: int) -> list[bytes]:
    """The packets after something has happened to those from ``at`` on."""
    head, some, tail = packets[:at], packets[at : at + n], packets[at + n :]
    if what in ("lost", "window"):
        return head + tail
    if what == "doubled":
        return head + [packet for packet in some for _ in range(2)] + tail
    if what == "swapped":
        return head + some[1:2] + some[:1] + some[2:] + tail
    if what == "late":
        return head + some[1:] + some[:1] + tail
    if what == "foreign":
        return [*head, vls_packet(0.0, product=0x22), *some, bytes(40), *tail]
    if what == "cut":
        return head + [packet[:-n] for packet in some[:1]] + some[1:] + tail
    return head + packets[: at + n]  # the sensor begins its count again


@pytest.mark.parametrize("kind", KINDS)
@given(
    things=disturbances,
    sizes=st.lists(st.integers(1, 90), min_size=1, max_size=12),
    cut_deg=st.sampled_from([0.0, 271.5]),
)
@settings(max_examples=12, deadline=None)
def test_many_at_a_time_are_as_one_by_one(
    kind: str, things: list[tuple[str, int, int]], sizes: list[int], cut_deg: float
) -> None:
    packets = turns(kind)
    for what, at, n in things:
        packets = disturbed(packets, what, at, n)
    stamps_ns = [1000 * k for k in range(len(packets))]
    single, together = (KINDS[kind].parser(METADATA[kind], cut_deg) for _ in range(2))
    fed = [single.feed(packet, stamp_ns) for packet, stamp_ns in zip(packets, stamps_ns, strict=True)]
    ends = [min(end, len(packets)) for end in accumulate(sizes * (len(packets) // sum(sizes) + 1), initial=0)]
    got = [
        revolution
        for first, end in pairwise(ends)
        for revolution in together.feed_all(packets[first:end], stamps_ns[first:end])
    ]
    assert_same(got, [revolution for revolution in fed if revolution is not None])
    assert counted(together) == counted(single)


@pytest.mark.parametrize("kind", KINDS)
def test_what_simply_follows_is_added_at_once(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    parser = KINDS[kind].parser(METADATA[kind], 0.0)
    added: list[int] = []
    add = parser.assembler.add
    monkeypatch.setattr(parser.assembler, "add", lambda packets, *how: (added.append(len(packets)), add(packets, *how)))
    parser.feed_all(turns(kind)[:80], range(80))
    assert added == ([1] * 80 if kind == "ouster" else [1, 79]), "an Ouster sends few, large packets"
