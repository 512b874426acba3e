"""The bytes of the devices: the line protocol, the VESC's packets, CAN frames by a DBC file."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config import ConfigError
from services.jetson.ego.can_signals import CanSignals
from services.jetson.ego.config import CanConfig
from services.jetson.ego.line_protocol import Line, LineReader, line_of, parse_line
from services.jetson.ego.measurement import Measurement, Rejected
from services.jetson.ego.vesc import REQUEST, Values, VescReader, packet

DBC = """VERSION ""
BS_:
BU_: CAR
BO_ 256 Motion: 8 CAR
 SG_ WheelSpeed : 0|16@1- (0.01,0) [-300|300] "km/h" CAR
 SG_ YawRate : 16|16@1- (0.1,0) [-500|500] "deg/s" CAR
 SG_ Odd : 32|8@1+ (1,0) [0|1] "furlongs" CAR
BO_ 512 Battery: 2 CAR
 SG_ Voltage : 0|16@1+ (1,0) [0|60000] "mV" CAR
"""
number = st.one_of(st.none(), st.integers(-30_000, 30_000))


def test_the_example_of_the_line_protocol() -> None:
    text = line_of(Line(17, 1250, -35, None, 11800))
    assert text == b"$SPOT,17,1250,-35,,11800*8962\n"
    (one,) = LineReader().feed(3.0, text)
    assert one == Measurement(3.0, "serial", 1.25, pytest.approx(-0.035), None, pytest.approx(11.8))  # type: ignore[arg-type]


@given(st.builds(Line, st.integers(0, 255), number, number, number, number), st.integers(0, 40))
def test_every_line_comes_back_however_it_is_cut(line: Line, cut: int) -> None:
    text = line_of(line)
    reader = LineReader()
    found = [*reader.feed(1.0, b"noise\n" + text[:cut]), *reader.feed(1.0, text[cut:])]
    assert found[0] == Rejected("serial", "nonsense")
    assert parse_line(text.strip()) == line
    assert isinstance(found[-1], Measurement)


@given(st.integers(0, 24), st.integers(1, 255))
def test_a_damaged_line_is_never_a_measurement(at: int, change: int) -> None:
    text = bytearray(line_of(Line(17, 1250, -35, None, 11800)))
    text[at] ^= change
    found = LineReader().feed(1.0, bytes(text))
    assert not any(isinstance(one, Measurement) for one in found)


def test_the_number_wraps_and_a_stuck_buffer_is_told() -> None:
    reader = LineReader()
    found = reader.feed(1.0, line_of(Line(255, 100)) + line_of(Line(256, 100)) + line_of(Line(256, 100)))
    assert [type(one) for one in found] == [Measurement, Measurement, Rejected]
    assert found[-1] == Rejected("serial", "repeated")


@pytest.mark.parametrize("text", [b"$SPOT*AAAA", b"$SPOT,*0000", b"$SPOT,300,,,,*0000", b"$SPOT,1,x,,,*0000", b"*"])
def test_lines_that_are_none(text: bytes) -> None:
    assert parse_line(text) is None


def test_a_line_without_end_is_given_up() -> None:
    assert LineReader().feed(1.0, b"x" * 200) == [Rejected("serial", "nonsense")]


def answer(erpm: int, tenth_v: int, fault: int = 0, *, tail: int = 20) -> bytes:
    """COMM_GET_VALUES as VESC firmware 5 and 6 answer it; ``tail`` is what newer ones add."""
    body = struct.pack(">BhhiiiihihiiiiiiB", 4, 251, 302, 100, 200, 0, 0, 123, erpm, tenth_v, 1, 2, 3, 4, 5, 6, fault)
    return packet(body + bytes(tail))


def test_the_vescs_own_bytes() -> None:
    assert bytes.fromhex("02 01 04 40 84 03") == REQUEST
    assert VescReader().feed(answer(-4600, 118)) == [Values(-4600, pytest.approx(11.8), 0)]
    (long,) = VescReader().feed(answer(77, 90, fault=3, tail=250))  # framed with a length of two bytes
    assert long == Values(77, pytest.approx(9.0), 3)


@given(st.integers(-(2**31), 2**31 - 1), st.integers(1, 70), st.binary(max_size=30).filter(lambda b: 2 not in b))
def test_answers_come_through_noise_and_cuts(erpm: int, cut: int, noise: bytes) -> None:
    noise = bytes(byte for byte in noise if byte != 3)
    whole, reader = noise + answer(erpm, 120), VescReader()
    found = [*reader.feed(whole[:cut]), *reader.feed(whole[cut:])]
    assert [one.erpm for one in found if isinstance(one, Values)] == [erpm]


@given(st.integers(2, 70), st.integers(0, 7))
def test_a_flipped_bit_is_no_answer(at: int, bit: int) -> None:
    data = bytearray(answer(1000, 120))
    data[at] ^= 1 << bit
    assert not [one for one in VescReader().feed(bytes(data)) if isinstance(one, Values)]


def test_another_answer_is_passed_over() -> None:
    assert VescReader().feed(packet(b"\x00firmware") + packet(bytes((4, 1, 2)))) == []


@pytest.fixture
def dbc(tmp_path: Path) -> str:
    pytest.importorskip("cantools")
    path = tmp_path / "car.dbc"
    path.write_text(DBC)
    return str(path)


def test_signals_come_in_the_units_of_the_file(dbc: str) -> None:
    signals = CanSignals(
        CanConfig(dbc=dbc, speed="Motion.WheelSpeed", yaw_rate="Motion.YawRate", battery="Battery.Voltage")
    )
    assert set(signals.frame_ids) == {256, 512}
    one = signals.measure(2.0, 256, struct.pack("<hhI", -3600, 450, 0))
    assert isinstance(one, Measurement)
    assert one.speed_mps == pytest.approx(-10.0)
    assert one.yaw_rate_radps == pytest.approx(math.radians(45.0))
    volts = signals.measure(2.0, 512, struct.pack("<H", 11800))
    assert isinstance(volts, Measurement)
    assert volts.battery_v == pytest.approx(11.8)
    assert signals.measure(2.0, 300, b"") is None
    assert signals.measure(2.0, 256, b"\x00") == Rejected("can", "nonsense")


@pytest.mark.parametrize(
    ("settings", "error_text"),
    [
        ({}, "name at least one signal"),
        ({"speed": "Motion.Warp"}, "no such signal in the DBC file; there are: Motion.WheelSpeed"),
        ({"speed": "Engine.Speed"}, "no such signal"),
        ({"speed": "Motion.Odd"}, "unit as 'furlongs'; allowed: m/s, km/h"),
    ],
)
def test_wrong_signals_are_refused(dbc: str, settings: dict[str, str], error_text: str) -> None:
    with pytest.raises(ConfigError, match=error_text):
        CanSignals(CanConfig(dbc=dbc, **settings))


def test_a_missing_dbc_file_is_named(tmp_path: Path) -> None:
    pytest.importorskip("cantools")
    with pytest.raises(ConfigError, match=r"none\.dbc"):
        CanSignals(CanConfig(dbc=str(tmp_path / "none.dbc"), speed="A.B"))
