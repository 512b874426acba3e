"""Turns are decoded while they come, end even if the head is stuck, and wait for no compiler."""

import numpy as np

from services.infra_lidar import ouster, velodyne
from services.infra_lidar.ouster import OusterFormat, OusterParser
from services.infra_lidar.revolutions import MOST_PACKETS, TOGETHER, decode_turn
from services.infra_lidar.velodyne import DECODER, Vls128Parser
from tests.infra_lidar.made_packets import metadata, ouster_packet, turns_of, vls_packet


def _walls(turns):
    """Packets of some turns with a wall somewhere else in each packet."""
    rng = np.random.default_rng(5)
    return [
        vls_packet((0.6 * k) % 360, steps=int(rng.integers(200, 9000)), time_us=166 * k) for k in range(turns * 600)
    ]


def test_a_turn_that_is_decoded_while_it_comes_is_the_same_as_at_once():
    parser = Vls128Parser()
    turns = [turn for k, packet in enumerate(_walls(3)) if (turn := parser.feed(packet, k)) is not None]
    kept = [turn.image.range_m.copy() for turn in turns]
    assert len(turns) == 2
    for turn, range_m in zip(turns, kept, strict=True):
        np.testing.assert_array_equal(turn.image.range_m, range_m)  # what comes later goes elsewhere
        np.testing.assert_array_equal(turn.points, decode_turn(turn.packets, DECODER).points)
    assert not np.array_equal(kept[0], kept[1])


def test_a_turn_is_the_sum_of_its_parts_however_many_they_are():
    packets = _walls(1)
    coming = DECODER.begin(0)
    for part in (packets[:1], packets[1:200], packets[200:], packets):
        coming.add(part)
    whole = coming.take().points
    assert len(whole) == 2 * 600 * 384
    np.testing.assert_allclose(whole[: 600 * 384], whole[600 * 384 :], atol=1e-4)
    assert len(coming.take()) == 0
    assert len(decode_turn(packets[: TOGETHER + 1], DECODER)) == (TOGETHER + 1) * 384


def test_a_head_that_is_stuck_fills_no_memory():
    packet, parser, turns = vls_packet(90.0), Vls128Parser(), []
    for _ in range(2 * MOST_PACKETS + 10):
        turn = parser.feed(packet, 0)
        turns += [turn] if turn is not None else []
    assert [len(turn.packets) for turn in turns] == [MOST_PACKETS] * 2
    assert not any(turn.quality.complete for turn in turns)

    layout, frames = OusterFormat(metadata()), OusterParser(OusterFormat(metadata()))
    packet = ouster_packet(layout, 7, 16)
    turns = [turn for _ in range(MOST_PACKETS + 1) if (turn := frames.feed(packet, 0)) is not None]
    assert [len(turn.packets) for turn in turns] == [MOST_PACKETS]
    assert not turns[0].quality.complete


def test_the_room_for_a_turn_follows_the_turns():
    coming = DECODER.begin(0)
    for packets in (600, 1200, 601, 100):
        for part in range(0, packets, TOGETHER):
            coming.add(_walls(1)[: min(TOGETHER, packets - part)])
        assert len(coming.take()) == packets * 384
    coming.add(_walls(1)[:1])
    assert coming.take().range_m.base.size < 200 * 384  # no longer that of the long turn


def test_the_first_packet_waits_for_no_compiler():
    velodyne.decode_nothing()
    turns_of(Vls128Parser())
    for profile in ("LEGACY", "RNG19_RFL8_SIG16_NIR16", "RNG15_RFL8_NIR8"):
        layout = OusterFormat(metadata(profile))
        decode_turn([ouster_packet(layout, 7, 0)], ouster.decoder(layout))
    for kernel in (velodyne._decode, velodyne._head_rate_deg_per_s):
        assert len(kernel.signatures) == 1
