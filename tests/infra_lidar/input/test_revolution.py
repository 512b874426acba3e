"""Revolutions are decoded while they come, and end even if the head is stuck."""

import numpy as np

from services.infra_lidar.input.ouster import OusterFormat, OusterParser
from services.infra_lidar.input.revolution import MAX_PACKETS, batch_of, decode_revolution, stack_packets
from services.infra_lidar.input.velodyne import DECODER, Vls128Parser
from tests.infra_lidar.made_packets import metadata, ouster_packet, vls_packet


def _packets(revolutions):
    """Packets of some revolutions with a wall at another distance in each packet."""
    rng = np.random.default_rng(5)
    return [
        vls_packet((0.6 * k) % 360, steps=int(rng.integers(200, 9000)), time_us=166 * k)
        for k in range(revolutions * 600)
    ]


def _feed(parser, packets):
    return [revolution for packet in packets if (revolution := parser.feed(packet, 0)) is not None]


def test_a_revolution_that_is_decoded_while_it_comes_is_the_same_as_at_once():
    first, second = _feed(Vls128Parser(), _packets(3))
    for revolution in (first, second):
        at_once = decode_revolution(stack_packets(revolution.packets), DECODER)
        np.testing.assert_array_equal(revolution.points, at_once.points)
        assert len(at_once) == 600 * 384
    assert not np.array_equal(first.points, second.points)


def test_a_revolution_of_any_number_of_packets_is_decoded():
    raw = stack_packets(_packets(1))
    batch = batch_of(raw.shape[1])
    for packets in (0, 1, batch, batch + 1, 600):
        image = decode_revolution(raw[:packets], DECODER)
        assert len(image) == image.returns == packets * 384


def test_stamps_follow_a_clock_that_is_set_back():
    parser, packets = Vls128Parser(), _packets(4)
    stamps_ns = [k * 166_000 + (10**12 if k < 1200 else 0) for k in range(len(packets))]
    found = [parser.feed(packet, stamp_ns) for packet, stamp_ns in zip(packets, stamps_ns, strict=True)]
    turns_ns = [revolution.stamp_ns for revolution in found if revolution]
    assert turns_ns[1] > 10**12 > turns_ns[2]


def test_a_head_that_is_stuck_fills_no_memory():
    revolutions = _feed(Vls128Parser(), [vls_packet(90.0, time_us=166 * k) for k in range(2 * MAX_PACKETS + 10)])
    assert [len(revolution.packets) for revolution in revolutions] == [MAX_PACKETS] * 2
    assert not any(revolution.quality.complete for revolution in revolutions)

    layout = OusterFormat(metadata())
    parser = OusterParser(layout)
    assert _feed(parser, [ouster_packet(layout, 7, 16)] * (MAX_PACKETS + 1)) == []  # the same packet over and over
    assert parser.order.counters == {"packet doubled": MAX_PACKETS}
