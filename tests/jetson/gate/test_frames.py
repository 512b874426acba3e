"""The frames to and from the actuator, byte by byte."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.jetson.gate.can_output import can_payload, crc8_j1850
from services.jetson.gate.firmware.micropython import gate_receiver
from services.jetson.gate.firmware.micropython.gate_receiver import GateReceiver
from services.jetson.gate.frames import CODES, PERMISSIONS, ReportReader, crc16, permission_frame
from services.jetson.gate.pipeline import Decision

GO = Decision("GO", 5.0, 0.2, "verdict", "clear")
SLOW = Decision("SLOW", 0.5, 0.1234, "verdict", "near")
STOP = Decision("STOP", 0.0, 0.0, "stale", "old")


def test_the_check_values_of_the_catalogues() -> None:
    assert crc16(b"123456789") == gate_receiver.crc16(b"123456789") == 0x29B1
    assert crc8_j1850(b"123456789") == 0x4B


def test_the_bytes_of_a_permission() -> None:
    frame = permission_frame(0x1FE, SLOW, 0.2, verdict_seq=0x12345)
    assert frame[:10].hex(" ") == "a5 01 fe 55 f4 01 7b 00 45 23"
    assert permission_frame(1, STOP, 0.2)[3:8].hex(" ") == "00 00 00 c8 00"
    assert can_payload(0x1FE, SLOW, 0.2)[1:].hex(" ") == "fe 55 f4 01 7b 01 00"


def test_can_frames_are_what_the_dbc_file_says() -> None:
    cantools = pytest.importorskip("cantools")
    database = cantools.database.load_file("services/jetson/gate/gate.dbc")
    fields = database.decode_message("GatePermission", can_payload(7, SLOW, 0.2))
    assert (fields["Sequence"], str(fields["Permission"]), fields["Expiry"], fields["Version"]) == (7, "SLOW", 123, 1)
    assert fields["SpeedLimit"] == pytest.approx(0.5)
    assert fields["Crc"] == crc8_j1850(can_payload(7, SLOW, 0.2)[1:])


def test_permissions_are_four_bits_apart() -> None:
    codes = list(CODES.values())
    assert min((a ^ b).bit_count() for a in codes for b in codes if a != b) == 4


def steady(receiver: GateReceiver, start_ms: int = 0) -> tuple[int, int]:
    """Frames for longer than the receiver wants: (time, sequence number) after the last."""
    now_ms, seq = start_ms, 0
    while receiver.permission != CODES["GO"]:
        now_ms, seq = now_ms + 20, seq + 1
        feed(receiver, permission_frame(seq, GO, 0.2), now_ms)
        assert now_ms - start_ms < 2000
    return now_ms, seq


def feed(receiver: GateReceiver, data: bytes, now_ms: int) -> bool:
    accepted = False
    for byte in data:
        accepted = receiver.feed(byte, now_ms) or accepted
    return accepted


def test_a_reporting_actuator_is_understood_among_rubbish() -> None:
    receiver, reader = GateReceiver(), ReportReader()
    _, seq = steady(receiver)
    reports = reader.feed(b"\x5a\x01" + receiver.report(3) + b"hello" + receiver.report(4)[:5])
    (one,) = reports
    assert (one.seq, one.permission, one.why, one.presses, one.refused) == (seq, "GO", "as told", 3, 0)
    assert reader.refused_bytes > 0
    (two,) = reader.feed(receiver.report(4)[5:])
    assert two.presses == 4


def test_nothing_moves_before_a_second_of_steady_frames() -> None:
    receiver = GateReceiver()
    now_ms, _ = steady(receiver, 500)
    assert now_ms - 500 == 1020


def test_it_stops_by_itself_when_the_frame_has_expired_and_then_wants_another_second() -> None:
    receiver = GateReceiver()
    now_ms, seq = steady(receiver)
    receiver.tick(now_ms + 200)
    assert receiver.permission == CODES["GO"]
    receiver.tick(now_ms + 201)
    assert (receiver.permission, receiver.limit_mm_s, receiver.why) == (0, 0, gate_receiver.FRAMES_STOPPED)
    feed(receiver, permission_frame(seq + 1, GO, 0.2), now_ms + 300)
    assert (receiver.permission, receiver.why) == (0, gate_receiver.NOT_STEADY_YET)


def test_a_repeated_or_overtaken_frame_prolongs_nothing() -> None:
    receiver = GateReceiver()
    now_ms, seq = steady(receiver)
    for again in (seq, seq - 1):
        assert not feed(receiver, permission_frame(again, GO, 0.2), now_ms + 150)
    receiver.tick(now_ms + 210)
    assert receiver.permission == 0


def test_a_stop_counts_whatever_its_number_and_slow_limits() -> None:
    receiver = GateReceiver()
    now_ms, seq = steady(receiver)
    feed(receiver, permission_frame(seq + 1, SLOW, 0.2), now_ms + 20)
    assert (receiver.permission, receiver.limit_mm_s) == (CODES["SLOW"], 500)
    assert feed(receiver, permission_frame(seq - 5, STOP, 0.2), now_ms + 30)
    assert (receiver.permission, receiver.why) == (0, gate_receiver.AS_TOLD)


@pytest.mark.parametrize("wrap_ms", [gate_receiver.TICKS_MASK + 1])
def test_the_clock_may_wrap(wrap_ms: int) -> None:
    receiver, start_ms = GateReceiver(), wrap_ms - 600
    for i in range(60):
        feed(receiver, permission_frame(i, GO, 0.2), (start_ms + 20 * i) % wrap_ms)
    assert receiver.permission == CODES["GO"]
    receiver.tick((start_ms + 59 * 20 + 201) % wrap_ms)
    assert receiver.permission == 0


@given(st.integers(0, 11), st.integers(0, 7), st.sampled_from([GO, SLOW, STOP]))
def test_a_flipped_bit_is_never_obeyed(byte: int, bit: int, decision: Decision) -> None:
    receiver = GateReceiver()
    now_ms, seq = steady(receiver)
    frame = bytearray(permission_frame(seq + 1, decision, 0.2))
    frame[byte] ^= 1 << bit
    assert not feed(receiver, bytes(frame), now_ms + 10)
    assert receiver.permission == CODES["GO"]
    receiver.tick(now_ms + 201)
    assert receiver.permission == 0


@given(st.lists(st.binary(max_size=40), max_size=20))
def test_random_bytes_never_move_it_and_never_break_it(chunks: list[bytes]) -> None:
    receiver, reader = GateReceiver(), ReportReader()
    for i, chunk in enumerate(chunks):
        feed(receiver, chunk, 20 * i)
        reader.feed(chunk)
    assert PERMISSIONS[receiver.permission] == "STOP"
    assert steady(receiver, 10_000)
