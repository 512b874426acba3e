"""The driver against the emulated chip: start-up, frames, faults and recovery, on a clock run by hand."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Iterator
from contextlib import closing

import msgspec
import numpy as np
import pytest

from common.config import ConfigError
from common.status import Report
from services.radar_pi import registers as reg
from services.radar_pi.chip import ChipRefused, RadarFault
from services.radar_pi.config import RadarConfig, WaveformConfig
from services.radar_pi.driver import Driver, RadarFrame
from services.radar_pi.emulator import EmulatedChip
from services.radar_pi.exports import plan
from services.radar_pi.packing import Layout
from services.radar_pi.registers import Register
from services.radar_pi.schedule import burst_words
from services.radar_pi.spi_source import keep_open, link_opener, open_spi

DEFAULT = plan(WaveformConfig())
SPEED_HZ = 50_000_000
TRANSIENT = {  # fault -> name under which it is counted, cure named in the status
    "overflow": ("fifo_overflow", "fifo reset"),
    "underflow": ("fifo_underflow", "fifo reset"),
    "clock_error": ("clock_error", "software reset"),
    "burst_error": ("burst_error", "software reset"),
    "power_cycle": ("stalled", "hardware reset"),
}


class Wire:
    """The emulated chip with everything that crosses the link written down."""

    def __init__(self, chip: EmulatedChip) -> None:
        self.chip = chip
        self.max_bytes = chip.max_bytes
        self.log: list[str] = []
        self.threads: set[int] = set()

    def transfer(self, data: bytes) -> bytes:
        self.threads.add(threading.get_ident())
        self.log.append(data[:4].hex())
        return self.chip.transfer(data)

    def set_reset(self, *, active: bool) -> None:
        self.log.append("reset" if active else "run")
        self.chip.set_reset(active=active)

    def wait_irq(self, timeout_s: float) -> bool:
        return self.chip.wait_irq(timeout_s)

    def close(self) -> None:
        self.log.append("close")


class Numbered:
    """A signal whose frames can be told apart; every frame that was measured is kept."""

    def __init__(self) -> None:
        self.measured: dict[int, tuple[float, np.ndarray]] = {}
        self._rng = np.random.default_rng(5)

    def __call__(self, t_s: float, waveform: WaveformConfig) -> np.ndarray:
        shape = (len(waveform.rx), waveform.chirps, waveform.samples)
        number = len(self.measured) + 1
        frame = self._rng.integers(1, 4096, shape, np.uint16)
        frame[0, 0, 0] = number
        self.measured[number] = (t_s, frame)
        return frame


@pytest.fixture
def signal() -> Numbered:
    return Numbered()


@pytest.fixture
def chip(clock, signal) -> EmulatedChip:
    return EmulatedChip(clock, signal, speed_hz=SPEED_HZ)


@pytest.fixture
def report() -> Report:
    return Report("test")


@pytest.fixture
def frames(chip, clock, report) -> Iterator[Iterator[RadarFrame]]:
    with closing(Driver(chip, clock, DEFAULT, SPEED_HZ, report).frames()) as running:
        yield running


def _command(register: Register, value: int | None = None) -> str:
    words = reg.read_command(register) if value is None else reg.write_command(register, value)
    return words.hex()


# --- start and stop ---------------------------------------------------------------------------------------------------


def test_start_up_sequence_on_the_wire(chip, clock, report) -> None:
    wire = Wire(chip)
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


def test_clean_stop_resets_the_state_machine_in_the_same_thread(chip, clock, report) -> None:
    wire = Wire(chip)
    frames = Driver(wire, clock, DEFAULT, SPEED_HZ, report).frames()
    next(frames)
    frames.close()
    assert wire.log[-2:] == [_command(Register.MAIN, 0x1E8274), "close"]
    assert wire.threads == {threading.get_ident()}


@pytest.mark.parametrize(("speed_hz", "bit"), [(50_000_000, 1), (21_000_000, 1), (20_000_000, 0), (1_000_000, 0)])
def test_miso_edge_follows_the_speed(chip, clock, report, speed_hz: int, bit: int) -> None:
    wire = Wire(chip)
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


class Forgetful(Wire):
    """These registers read zero."""

    def __init__(self, chip: EmulatedChip, *forgotten: Register) -> None:
        super().__init__(chip)
        self._reads = [reg.read_command(register) for register in forgotten]

    def transfer(self, data: bytes) -> bytes:
        reply = super().transfer(data)
        return bytes([reply[0], 0, 0, 0]) if data in self._reads else reply


def test_a_register_that_does_not_keep_its_value_is_told_with_every_frame(chip, clock, report) -> None:
    wire = Forgetful(chip, Register.PACR1)
    with closing(Driver(wire, clock, DEFAULT, SPEED_HZ, report).frames()) as frames:
        assert next(frames).note == "register PACR1 reads 0x000000 after 0xe967fd"


def test_a_link_that_forgets_many_registers_is_refused(chip, clock, report) -> None:
    wire = Forgetful(chip, Register.PACR1, Register.ADC0, Register.CCR2, Register.PLL1_0)
    with pytest.raises(RadarFault, match="4 of 38 registers do not keep their value: ADC0 reads 0x000000 after"):
        next(Driver(wire, clock, DEFAULT, SPEED_HZ, report).frames())


def test_self_test_failure_is_told_with_every_frame_but_does_not_silence_the_radar(chip, clock, report) -> None:
    class Noisy(Wire):
        """Bit 4 of every 500th byte of the test burst is wrong."""

        def transfer(self, data: bytes) -> bytes:
            reply = bytearray(super().transfer(data))
            if len(reply) == 4 + 3 * 256:
                reply[499] ^= 0x10
            return bytes(reply)

    with closing(Driver(Noisy(chip), clock, DEFAULT, SPEED_HZ, report).frames()) as frames:
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


# --- faults -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fault", TRANSIENT)
@pytest.mark.parametrize("at_s", [0.16, 0.22655, 0.2333, 0.2409, 0.2419])
def test_after_a_transient_fault_frames_flow_again_within_half_a_second(
    frames, chip, clock, report, signal, fault: str, at_s: float
) -> None:
    """The moments lie in the pause between frames and in the middle of chirping."""
    name, cure = TRANSIENT[fault]
    first = next(frames)
    clock.at(at_s, lambda: chip.inject(fault))
    hit_ns = clock.utc_ns() - round((clock.now_s - 1000.0 - at_s) * 1e9)
    after = next(f for f in frames if f.epoch > first.epoch)
    assert 0 < clock.utc_ns() - hit_ns < 0.5e9
    assert after.epoch == first.epoch + 1  # the background model is void
    status = report.snapshot()
    assert status.counters[name] == 1
    assert status.state == "degraded"
    assert cure in status.reason
    assert "clutter background starts again" in status.reason
    for frame in (after, *itertools.islice(frames, 3)):
        assert np.array_equal(frame.samples, signal.measured[int(frame.samples[0, 0, 0])][1])
        assert frame.epoch == after.epoch


@pytest.mark.parametrize("at_s", [0.2285, 0.233, 0.2371, 0.2412])
def test_lost_words_cost_one_frame_and_no_restart(frames, chip, clock, report, signal, at_s: float) -> None:
    seen = [next(frames)]
    clock.at(at_s, lambda: chip.inject("lost_words"))
    seen += itertools.islice(frames, 8)
    assert {frame.epoch for frame in seen} == {1}
    assert all(np.array_equal(f.samples, signal.measured[int(f.samples[0, 0, 0])][1]) for f in seen)
    status = report.snapshot()
    assert status.dropped == 1
    assert status.counters["lost_words"] == 12480 - 7
    periods = np.diff([f.stamp_ns for f in seen]) / (DEFAULT.timing.frame_period_s * 1e9)
    assert sorted(np.round(periods, 3)) == [1.0] * 7 + [2.0]


@pytest.mark.parametrize("fault", ["dead_irq", "stuck_irq"])
def test_a_dead_interrupt_is_polled_around_and_reported(frames, chip, clock, report, fault: str) -> None:
    next(frames)
    clock.at(0.2, lambda: chip.inject(fault))
    polled = [frame for frame in itertools.islice(frames, 12) if frame.note]
    assert len(polled) >= 8
    assert polled[-1].note == "interrupt line is not to be trusted: polling; check [spi] irq_gpio"
    lasts_ns = [f.received_ns - f.stamp_ns - DEFAULT.timing.first_chirp_to_end_s * 1e9 for f in polled]
    assert max(lasts_ns) < 5e6
    assert report.snapshot().dropped == 0
    chip.heal(fault)
    assert any(not frame.note for frame in itertools.islice(frames, 10))  # trusted again


def test_an_interrupt_that_is_dead_from_the_start(chip, clock, report) -> None:
    chip.inject("dead_irq")
    with closing(Driver(chip, clock, DEFAULT, SPEED_HZ, report).frames()) as frames:
        notes = [frame.note for frame in itertools.islice(frames, 3)]
    assert "not to be trusted" in notes[-1]
    assert report.snapshot().counters == {}


def test_polling_does_not_hammer_the_bus(chip, clock, report) -> None:
    wire = Wire(chip)
    chip.inject("dead_irq")
    with closing(Driver(wire, clock, DEFAULT, SPEED_HZ, report).frames()) as frames:
        next(frames)
        before = len(wire.log)
        next(frames)
    assert len(wire.log) - before < 13 * 3 + 5  # burst, FSTAT and perhaps one look too early


@pytest.mark.parametrize("pause_s", [0.02, 0.06, 0.15, 2.0])
def test_a_slow_reader_gets_true_stamps_and_fresh_frames(frames, chip, clock, report, signal, pause_s: float) -> None:
    """After 20 and 60 ms nothing is lost; later the FIFO overflows, and what follows is new."""
    next(frames)
    clock.sleep(pause_s)
    resumed_ns = clock.utc_ns()
    frame = next(frames)
    t_s, samples = signal.measured[int(frame.samples[0, 0, 0])]
    assert np.array_equal(frame.samples, samples)
    assert frame.stamp_ns == pytest.approx(t_s * 1e9, abs=1e5)
    assert clock.utc_ns() - resumed_ns < 0.5e9
    assert frame.received_ns - frame.stamp_ns < 0.1e9
    overflowed = report.snapshot().counters.get("fifo_overflow", 0)
    assert overflowed == (0 if pause_s < 0.09 else 1)
    assert frame.epoch == 1 + overflowed


def test_a_reader_that_is_always_too_slow_still_gets_frames(frames, clock, report) -> None:
    for frame in itertools.islice(frames, 6):
        assert frame.received_ns - frame.stamp_ns < 0.05e9  # never an old one
        clock.sleep(0.3)
    assert report.snapshot().counters["fifo_overflow"] == 5


def test_a_fault_that_no_cure_ends_is_handed_up(chip, clock, report) -> None:
    class Broken(Wire):
        """Overflow, whatever is done."""

        def transfer(self, data: bytes) -> bytes:
            reply = super().transfer(data)
            if data[:4] == reg.burst_command() and len(data) > 800:
                self.chip.inject("burst_error")
                return bytes([0xF2]) + reply[1:]
            return reply

    wire = Broken(chip)
    with pytest.raises(RadarFault, match="SPI burst error"):
        next(Driver(wire, clock, DEFAULT, SPEED_HZ, report).frames())
    assert wire.log.count("reset") >= 4  # hardware resets were tried
    assert wire.log[-1] == "close"


# --- keep open --------------------------------------------------------------------------------------------------------


def test_a_chip_that_goes_and_comes_back(chip, clock, report, signal) -> None:
    frames = keep_open(lambda: chip, clock, DEFAULT, SPEED_HZ, report)
    states = []
    first = next(frames)
    clock.at(0.25, lambda: chip.inject("unplugged"))
    clock.at(2.0, lambda: states.append(report.snapshot()))
    clock.at(3.0, lambda: chip.heal("unplugged"))
    back = next(frame for frame in frames if frame.epoch > first.epoch)
    (away,) = states
    assert away.state == "disconnected"
    assert "expected chip id 0x000303" in away.reason
    assert "next try in" in away.reason
    assert 3.0 < clock.now_s - 1000.0 < 6.0  # bounded back-off
    assert np.array_equal(back.samples, signal.measured[int(back.samples[0, 0, 0])][1])
    frames.close()


def test_a_wrong_chip_is_reported_and_never_read(chip, clock, report) -> None:
    chip.inject("wrong_chip")
    wire = Wire(chip)
    frames = keep_open(lambda: wire, clock, DEFAULT, SPEED_HZ, report)
    clock.at(30.0, lambda: chip.heal("wrong_chip"))
    clock.at(29.0, lambda: wire.log.append(report.snapshot().reason))
    next(frames)
    told = next(entry for entry in wire.log if "expected" in entry)
    assert "found 0x000606" in told
    assert "ffc00000" not in wire.log[: wire.log.index(told)]
    frames.close()


def test_a_bus_that_cannot_be_opened_is_tried_again(chip, clock, report) -> None:
    failures = iter([PermissionError(13, "not in group spi"), FileNotFoundError(2, "no /dev/spidev0.0")])

    def opened() -> EmulatedChip:
        for failure in failures:
            raise failure
        return chip

    frames = keep_open(opened, clock, DEFAULT, SPEED_HZ, report)
    assert next(frames).epoch == 1
    assert report.snapshot().counters["bus_lost"] == 2
    assert "no /dev/spidev0.0" in report.snapshot().reason
    frames.close()


@pytest.mark.parametrize("target", ["0", "a.b", "emulator/nowhere", "0.0.0"])
def test_a_target_that_is_none_is_refused(target: str, report) -> None:
    with pytest.raises(ConfigError, match="source spi:"):
        open_spi(target, RadarConfig(), report)


def test_the_emulator_as_a_source_on_the_machines_clock(report) -> None:
    """A fast small waveform: two frames in real time, from the simulated world."""
    waveform = WaveformConfig(samples=64, chirps=16, sample_rate_hz=2e6, chirp_period_s=0.2e-3, frame_period_s=0.02)
    frames = open_spi("emulator", RadarConfig(waveform=waveform), report)
    with closing(frames):  # type: ignore[type-var]
        first, second = next(frames), next(frames)
    assert first.samples.shape == (3, 16, 64)
    assert second.stamp_ns > first.stamp_ns


def test_hardware_without_its_libraries_says_which_extra(clock) -> None:
    try:
        import spidev  # noqa: F401
    except ImportError:
        with pytest.raises(OSError, match="install the extra radar-hw"):
            link_opener("0.0", RadarConfig().spi, clock)()
    else:
        pytest.skip("spidev is installed here")
