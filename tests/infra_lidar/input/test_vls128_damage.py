"""Packets of a VLS-128, cut or with wrong bits: nothing is raised, and no point is farther than a range can be."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.infra_lidar.input.models import KINDS
from services.infra_lidar.input.velodyne import DUAL_RETURN, MODE_AT, PACKET_BYTES

STRONGEST, BANKS = 0x37, (0xEEFF, 0xDDFF, 0xCCFF, 0xBBFF)
FARTHEST_M = 65535 * 0.004 + 0.1  # and the beams' origins
RNG = np.random.default_rng(6)


def busy_packet(mode: int, number: int) -> bytes:
    """The packet of that number of a turn: random ranges, all banks in turn or each of them twice."""
    blocks = b""
    for block in range(12):
        bank, sequence = (block // 2, 0) if mode == DUAL_RETURN else (block % 4, block // 4)
        blocks += struct.pack("<HH", BANKS[bank % 4], 20 * (3 * number + sequence) % 36000)
        blocks += b"".join(struct.pack("<HB", int(steps), 9) for steps in RNG.integers(0, 65536, 32))
    return blocks + struct.pack("<IBB", 166 * number, mode, 0xA1)


BUSY = {mode: [busy_packet(mode, number) for number in range(4)] for mode in (STRONGEST, DUAL_RETURN)}
FLIPS = st.lists(st.tuples(st.integers(0, PACKET_BYTES - 1), st.integers(1, 255)), max_size=6)
LAST_BLOCKS = st.lists(st.tuples(st.integers(1100, PACKET_BYTES - 1), st.integers(1, 255)), max_size=6)


@pytest.mark.parametrize("mode", [STRONGEST, DUAL_RETURN], ids=["single return", "dual return"])
@pytest.mark.parametrize("which", range(4))
@settings(max_examples=150, deadline=None)
@given(length=st.one_of(st.just(PACKET_BYTES), st.integers(0, 1400)), flips=st.one_of(FLIPS, LAST_BLOCKS))
def test_broken_packets_raise_nothing_and_are_no_far_points(
    mode: int, which: int, length: int, flips: list[tuple[int, int]]
) -> None:
    broken = bytearray((BUSY[mode][which] + bytes(200))[:length])
    for at, bits in flips:
        if at < len(broken):
            broken[at] ^= bits
    packets = [*BUSY[mode][:which], bytes(broken), *BUSY[mode][which + 1 :]]
    parser = KINDS["velodyne"].parser("", 0.0)
    ended = [parser.feed(packet, number) for number, packet in enumerate(packets)]
    turns = [turn for turn in (*ended, parser.assembler.finish()) if turn is not None]
    assert turns
    assert sum(len(turn.packets) for turn in turns) >= 1
    for turn in turns:
        assert np.isfinite(turn.points).all()
        assert np.linalg.norm(turn.points[:, :3], axis=1).max(initial=0.0) <= FARTHEST_M


@pytest.mark.parametrize("mode", [STRONGEST, DUAL_RETURN])
def test_the_packets_are_whole_before_they_are_broken(mode: int) -> None:
    parser = KINDS["velodyne"].parser("", 0.0)
    assert [parser.feed(packet, number) for number, packet in enumerate(BUSY[mode])] == [None] * 4
    turn = parser.assembler.finish()
    assert turn is not None
    assert (len(turn.packets), parser.rejected) == (4, 0)
    assert {packet[MODE_AT] for packet in turn.packets} == {mode}
    assert 200.0 < np.linalg.norm(turn.points[:, :3], axis=1).max() <= FARTHEST_M
