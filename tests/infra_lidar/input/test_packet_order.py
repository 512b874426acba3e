"""Doubled, late and lost packets, and a field of view that is set in the sensor, told apart."""

from __future__ import annotations

import numpy as np
import pytest

from services.infra_lidar.input.ouster import OusterFormat, OusterParser
from services.infra_lidar.input.revolution import PacketOrder, Revolution
from services.infra_lidar.input.velodyne import Vls128Parser
from tests.infra_lidar.made_packets import metadata, ouster_packet, vls_packet

STEP_US = 166


def vls_turns(turns: int, shown: range = range(600)) -> list[bytes]:
    """Packets of a head that turns on while a window in the sensor lets only the packets ``shown`` of each turn out."""
    window = set(shown)
    numbers = [k for k in range(600 * turns) if k % 600 in window]
    return [vls_packet((0.6 * k) % 360, time_us=STEP_US * k) for k in numbers]


def feed(parser: Vls128Parser | OusterParser, packets: list[bytes]) -> list[Revolution]:
    return [done for packet in packets if (done := parser.feed(packet, 0)) is not None]


def test_swapped_neighbours_are_late_and_not_lost() -> None:
    packets = vls_turns(4)
    for at in (100, 599, 900, 1199, 1500):  # 599 and 1199: over the seam
        packets[at], packets[at + 1] = packets[at + 1], packets[at]
    parser = Vls128Parser()
    revolutions = feed(parser, packets)
    assert len(revolutions) == 3
    assert all(revolution.quality.complete for revolution in revolutions)
    assert sum(revolution.quality.packets_lost for revolution in revolutions) <= 2  # the two whose turn had ended
    assert parser.order.counters["packet late"] == 5
    assert len(revolutions[0].points) in (600 * 384, 599 * 384)


def test_a_mirror_port_doubles_nothing() -> None:
    once = feed(Vls128Parser(), vls_turns(3))
    parser = Vls128Parser()
    twice = feed(parser, [packet for packet in vls_turns(3) for _ in range(2)])
    assert parser.order.counters["packet doubled"] == 1800
    for a, b in zip(once, twice, strict=True):
        np.testing.assert_array_equal(a.points, b.points)
        assert b.quality == a.quality


def test_true_loss_is_still_counted() -> None:
    packets = vls_turns(6)
    del packets[2000:2030]
    parser = Vls128Parser()
    lost = [revolution.quality.packets_lost for revolution in feed(parser, packets)]
    assert lost == [0, 0, 0, 30, 0]


@pytest.mark.parametrize(
    "shown",
    [range(167, 400), range(0, 300), [*range(500, 600), *range(100)]],
    ids=["100 to 240 degrees", "front half", "300 to 60 degrees"],
)
def test_a_window_in_the_sensor_is_no_loss(shown: range) -> None:
    parser = Vls128Parser()
    revolutions = feed(parser, vls_turns(8, shown))
    assert len(revolutions) == 7
    assert [revolution.quality.packets_lost for revolution in revolutions[2:]] == [0] * 5
    assert all(revolution.quality.complete for revolution in revolutions[2:])
    assert all(len(revolution.packets) == len(shown) for revolution in revolutions[1:])


def test_loss_within_a_window_is_counted() -> None:
    packets = vls_turns(8, range(0, 300))
    del packets[1600:1620]
    lost = [revolution.quality.packets_lost for revolution in feed(Vls128Parser(), packets)]
    assert lost[2:] == [0, 0, 0, 20, 0]


def test_an_ousters_swapped_and_doubled_packets() -> None:
    layout = OusterFormat(metadata())
    packets = [ouster_packet(layout, frame, column) for frame in range(1, 5) for column in range(0, 64, 16)]
    packets[5], packets[6] = packets[6], packets[5]
    packets.insert(9, packets[9])
    parser = OusterParser(layout)
    revolutions = feed(parser, packets)
    assert [revolution.quality.packets_lost for revolution in revolutions] == [0, 0, 0]
    assert parser.order.counters == {"packet late": 1, "packet doubled": 1}


def test_an_ousters_column_window_is_no_loss() -> None:
    layout = OusterFormat(metadata(columns=512))
    packets = [ouster_packet(layout, frame, column) for frame in range(1, 8) for column in range(128, 384, 16)]
    revolutions = feed(OusterParser(layout), packets)
    assert all(revolution.quality.complete for revolution in revolutions[1:])
    assert [revolution.quality.packets_lost for revolution in revolutions[1:]] == [0] * 5


@pytest.mark.parametrize(
    ("positions", "missing"),
    [
        ([5, 6, 7], [0, 0, 0]),
        ([5, 8, 6, 7, 9], [0, 2, -1, -1, 0]),
        ([5, 5, 6], [0, None, 0]),
        ([98, 99, 0, 1], [0, 0, 0, 0]),
        ([98, 1, 99], [0, 2, -1]),
        ([5, 60], [0, 0]),  # farther than any gap: started anew
    ],
)
def test_order(positions: list[int], missing: list[int | None]) -> None:
    order = PacketOrder(period=100, farthest=40)
    assert [order.missing(position, 1.0) for position in positions] == missing
