"""The driver against the emulated chip: start-up, stop and frames, on a clock run by hand."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable
from contextlib import closing

import msgspec
import numpy as np
import pytest

from common.config import ConfigError
from services.radar_pi.chip import registers as reg
from services.radar_pi.chip.chip import ChipRefused, RadarFault
from services.radar_pi.chip.driver import Driver
from services.radar_pi.chip.exports import plan
from services.radar_pi.chip.packing import Layout
from services.radar_pi.chip.registers import Register
from services.radar_pi.chip.schedule import burst_words
from services.radar_pi.config import WaveformConfig
from services.radar_pi.emulator.emulator import EmulatedChip

DEFAULT = plan(WaveformConfig())
SPEED_HZ = 50_000_000


@pytest.fixture
def chip(numbered_chip):
    """Each of its frames can be told apart."""
    return numbered_chip


def _command(register: Register, value: int | None = None) -> str:
    words = reg.read_command(register) if value is None else reg.write_command(register, value)
    return words.hex()


# --- start and stop ---------------------------------------------------------------------------------------------------


def test_start_up_sequence_on_the_wire(chip, clock, report, wire_class) -> None:
    wire = wire_class(chip)
    with closing(Driver(wire, clock, DEFAULT, SPEED_HZ, report).frames()) as frames:
        next(frames)
    log = wire.log
    high_speed = _command(Register.SFCTL, 0x010000)
    beginning = ["run", "reset", "run", high_speed, _command(Register.CHIP_ID), _command(Register.MAIN, 0x000002)]
    assert log[:6] == beginning
    assert log[6:8] == [high_speed, _command(Register.MAIN)]  # high speed again, then poll the reset bit
    sfctl = 0x152000 | 959  # wait cycle, header, high speed, FIFO low power; the mark one below the burst
    written = DEFAULT.registers | {Register.SFCTL: sfctl}
    assert log[8 : 8 + 38] == [_command(Register(a), v) for a, v in written.items()]
    assert log[46 : 46 + 38] == [_command(Register(a)) for a in written]  # read back
    assert log.pop(87) == _command(Register.FSTAT)  # is the test pattern complete?
    test = log[84:91]
    assert test[0] == _command(Register.CS1_U_1, 0x1FF41F)  # receiver 1 alone
    assert int(test[1], 16) & reg.LFSR_EN.mask
    assert not int(test[1], 16) & reg.PREFIX_EN.mask
    assert test[2:4] == [_command(Register.MAIN, 0x1E8271), "ffc00000"]
    assert test[4:] == [
        _command(Register.MAIN, 0x1E8278),
        _command(Register.SFCTL, sfctl),
        _command(Register.CS1_U_1, 0x7FF41F),
    ]
    assert log[91:93] == [_command(Register.MAIN, 0x1E8278), _command(Register.MAIN, 0x1E8271)]
    assert log[93:106] == ["ffc00000"] * 13  # one burst after the other ...
    assert log[106] == _command(Register.FSTAT)  # ... and the proof that nothing was lost


def test_clean_stop_resets_the_state_machine_in_the_same_thread(chip, clock, report, wire_class) -> None:
    wire = wire_class(chip)
    frames = Driver(wire, clock, DEFAULT, SPEED_HZ, report).frames()
    next(frames)
    frames.close()
    assert wire.log[-2:] == [_command(Register.MAIN, 0x1E8274), "close"]
    assert wire.threads == {threading.get_ident()}


@pytest.mark.parametrize(("speed_hz", "bit"), [(50_000_000, 1), (21_000_000, 1), (20_000_000, 0), (1_000_000, 0)])
def test_miso_edge_follows_the_speed(chip, clock, report, wire_class, speed_hz: int, bit: int) -> None:
    wire = wire_class(chip)
    with closing(Driver(wire, clock, DEFAULT, speed_hz, report).frames()) as frames:
        next(frames)
    writes = [int(w, 16) for w in wire.log if len(w) == 8 and int(w, 16) >> 24 == Register.SFCTL << 1 | 1]
    assert writes
    assert all(reg.MISO_HS_RD.value(w) == bit for w in writes)


def test_a_wrong_chip_is_refused_with_expected_and_found(chip, clock, report) -> None:
    chip.inject("wrong_chip")
    frames = Driver(chip, clock, DEFAULT, SPEED_HZ, report).frames()
    with pytest.raises(ChipRefused, match=r"expected chip id 0x000303 \(BGT60TR13C\), found 0x000606: another chip"):
        next(frames)


def test_no_chip_is_refused_with_a_hint(chip, clock, report) -> None:
    chip.inject("unplugged")
    frames = Driver(chip, clock, DEFAULT, SPEED_HZ, report).frames()
    with pytest.raises(ChipRefused, match="found 0x000000: no chip answers: HAT seated, SPI enabled"):
        next(frames)


def reads_zero(*forgotten: Register) -> Callable[[bytes, bytes], bytes]:
    """A chip whose registers of these names read zero."""
    reads = [reg.read_command(register) for register in forgotten]
    return lambda sent, reply: bytes([reply[0], 0, 0, 0]) if sent in reads else reply


def test_a_register_that_does_not_keep_its_value_is_told_with_every_frame(chip, clock, report, wire_class) -> None:
    wire = wire_class(chip, reads_zero(Register.PACR1))
    with closing(Driver(wire, clock, DEFAULT, SPEED_HZ, report).frames()) as frames:
        assert next(frames).note == "register PACR1 reads 0x000000 after 0xe967fd"


def test_a_link_that_forgets_many_registers_is_refused(chip, clock, report, wire_class) -> None:
    wire = wire_class(chip, reads_zero(Register.PACR1, Register.ADC0, Register.CCR2, Register.PLL1_0))
    with pytest.raises(RadarFault, match="4 of 38 registers do not keep their value: ADC0 reads 0x000000 after"):
        next(Driver(wire, clock, DEFAULT, SPEED_HZ, report).frames())


def test_self_test_failure_is_told_with_every_frame_but_does_not_silence_the_radar(
    chip, clock, report, wire_class
) -> None:
    def noisy(sent: bytes, reply: bytes) -> bytes:
        """Bit 4 of one byte of the test burst is wrong."""
        spoilt = bytearray(reply)
        if len(reply) == 4 + 3 * 256:
            spoilt[499] ^= 0x10
        return bytes(spoilt)

    with closing(Driver(wire_class(chip, noisy), clock, DEFAULT, SPEED_HZ, report).frames()) as frames:
        noted = [next(frames).note for _ in range(2)]
    assert noted == ["link self-test: 1 of 512 samples wrong; lower [spi] speed_hz"] * 2
    assert report.snapshot().counters["link_self_test"] == 3


# --- frames -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "change",
    [
        {},
        {
            "rx_mask": 5,
            "samples": 512,
            "chirps": 16,
            "sample_rate_hz": 1e6,
            "chirp_period_s": 2e-3,
            "frame_period_s": 0.2,
        },
        {"rx_mask": 2, "samples": 64, "chirps": 32, "frame_period_s": 0.02},
        {"samples": 50, "chirps": 7, "chirp_period_s": 1e-4, "frame_period_s": 0.005},
    ],
    ids=["default", "track", "one_rx", "small"],
)
def test_frames_are_what_was_measured_bit_for_bit_and_stamped_at_their_first_chirp(
    clock, chip, signal, report, change
) -> None:
    what = plan(msgspec.structs.replace(WaveformConfig(), **change))
    with closing(Driver(chip, clock, what, SPEED_HZ, report).frames()) as frames:
        for frame in itertools.islice(frames, 4):
            t_s, samples = signal.measured[int(frame.samples[0, 0, 0])]
            assert np.array_equal(frame.samples, samples)
            assert frame.samples.flags.c_contiguous
            assert frame.stamp_ns == pytest.approx(t_s * 1e9, abs=5e3)  # microseconds
            assert (frame.epoch, frame.note) == (1, "")
    assert report.snapshot().counters == {}
    assert report.snapshot().dropped == 0


def test_a_frame_is_delivered_within_5_ms_of_its_last_sample(frames, clock) -> None:
    for frame in itertools.islice(frames, 10):
        last_sample_ns = frame.stamp_ns + DEFAULT.timing.first_chirp_to_end_s * 1e9
        assert 0 < clock.utc_ns() - last_sample_ns < 1e6  # one burst of 960 words takes 0.46 ms
        assert frame.received_ns == clock.utc_ns()


def test_frames_follow_at_the_frame_period(frames) -> None:
    stamps_ns = [frame.stamp_ns for frame in itertools.islice(frames, 5)]
    assert np.diff(stamps_ns) == pytest.approx(DEFAULT.timing.frame_period_s * 1e9, abs=2e3)


def test_drifting_crystals_do_not_pull_the_schedule_away(clock, signal, report) -> None:
    """The host's clock runs 100 ppm faster: half a minute is 3 ms."""

    class Fast:
        def monotonic_s(self) -> float:
            return clock.monotonic_s() * 1.0001

        def utc_ns(self) -> int:
            return clock.utc_ns()

        def sleep(self, seconds: float) -> None:
            clock.sleep(seconds / 1.0001)

    small = plan(WaveformConfig(samples=32, chirps=8, sample_rate_hz=2e6, chirp_period_s=2e-4, frame_period_s=0.1))
    chip = EmulatedChip(clock, signal, SPEED_HZ)
    with closing(Driver(chip, Fast(), small, SPEED_HZ, report).frames()) as frames:
        for frame in itertools.islice(frames, 300):
            last_ns = frame.stamp_ns + small.timing.first_chirp_to_end_s * 1e9
            assert clock.utc_ns() - last_ns < 1e6
    assert report.snapshot().counters == {}


@pytest.mark.parametrize(
    ("layout", "max_bytes", "words"),
    [
        (Layout(3, 64, 128), 4096, 960),  # 12480 words: 13 bursts
        (Layout(3, 64, 128), 65536, 960),  # never more than an eighth of the FIFO
        (Layout(3, 64, 128), 1024, 320),
        (Layout(3, 64, 64), 4096, 792),
        (Layout(1, 2, 16), 4096, 22),  # the whole frame
    ],
)
def test_the_burst_divides_the_frame_and_fits_the_transfer(layout: Layout, max_bytes: int, words: int) -> None:
    assert burst_words(layout, max_bytes) == words
    assert layout.frame_words % words == 0
    assert 4 + 3 * words <= max_bytes


def test_a_frame_that_cannot_be_cut_evenly_is_refused() -> None:
    with pytest.raises(ConfigError, match="cannot be cut into equal bursts"):
        burst_words(Layout(2, 1, 4001 - 3), 4096)  # 4001 is prime
