"""The radar's driver: unpacking against plain loops, and what the emulated chip shows of latency and recovery.

Latency and recovery are times on the emulated clock (50 MHz bus included): they tell what chip and driver do, not how
fast this machine is.
"""

from __future__ import annotations

import logging
import timeit
from contextlib import closing

import numpy as np

from common.bus.status import Report
from services.radar_pi.chip.driver import Driver
from services.radar_pi.chip.exports import plan
from services.radar_pi.chip.packing import HEADER_WORDS, FrameAssembler, Layout, pack_frame, unpack_frame
from services.radar_pi.config import WaveformConfig
from services.radar_pi.emulator import signals
from services.radar_pi.emulator.emulator import EmulatedChip
from services.radar_pi.emulator.manual_clock import START_S, ManualClock

SPEED_HZ = 50_000_000
LAYOUT = Layout(rx=3, chirps=64, samples=128)
BURST_WORDS = 960
FAULTS = ("overflow", "underflow", "clock_error", "burst_error", "lost_words", "power_cycle", "dead_irq", "stuck_irq")
FAULT_S = 0.2333  # while chirping


def plain_unpack(packed: np.ndarray, layout: Layout) -> np.ndarray:
    """The data sheet's layout as nested loops over chirps, words and samples."""
    frame = np.empty((layout.rx, layout.chirps, layout.samples), np.uint16)
    for chirp in range(layout.chirps):
        data = packed[chirp, 3 * HEADER_WORDS :].tolist()
        samples = []
        for n in range(0, len(data), 3):
            b0, b1, b2 = data[n : n + 3]
            samples += [b0 << 4 | b1 >> 4, (b1 & 15) << 8 | b2]
        for rx in range(layout.rx):
            frame[rx, chirp] = samples[rx :: layout.rx]
    return frame


def assemble(stream: bytes) -> None:
    """One frame through the assembler, burst by burst."""
    assembler = FrameAssembler(LAYOUT)
    for start in range(0, len(stream), 3 * BURST_WORDS):
        list(assembler.feed(stream[start : start + 3 * BURST_WORDS]))


def measure_unpacking() -> tuple[float, float, float]:
    """Milliseconds per 3 x 64 x 128 frame: unpacking, plain loops, assembling from bursts."""
    frame = np.random.default_rng(0).integers(1, 4096, (3, 64, 128), np.uint16)
    packed = pack_frame(frame, 0)
    if not np.array_equal(unpack_frame(packed, LAYOUT), plain_unpack(packed, LAYOUT)):
        raise RuntimeError("fast and plain unpacking differ")
    stream = packed.tobytes()
    fast_s = min(timeit.repeat(lambda: unpack_frame(packed, LAYOUT), number=100, repeat=7)) / 100
    plain_s = min(timeit.repeat(lambda: plain_unpack(packed, LAYOUT), number=2, repeat=3)) / 2
    assemble_s = min(timeit.repeat(lambda: assemble(stream), number=20, repeat=5)) / 20
    return fast_s * 1e3, plain_s * 1e3, assemble_s * 1e3


def measure_fault(fault: str) -> tuple[float, float, int]:
    """(ms from the fault to the next frame, worst latency of the frames after it in ms, restarts)."""
    clock, what = ManualClock(), plan(WaveformConfig())
    chip = EmulatedChip(clock, signals.silence, SPEED_HZ)
    clock.at(FAULT_S, lambda: chip.inject(fault) if fault else None)
    latency_ms, back_s = [0.0], 0.0
    with closing(Driver(chip, clock, what, SPEED_HZ, Report("bench")).frames()) as frames:
        for frame in frames:
            if clock.now_s > START_S + FAULT_S:
                back_s = back_s or clock.now_s - START_S - FAULT_S
                end_ns = frame.stamp_ns + what.timing.first_chirp_to_end_s * 1e9
                latency_ms.append((clock.utc_ns() - end_ns) * 1e-6)
            if clock.now_s > START_S + 2.0:
                return back_s * 1e3, max(latency_ms), frame.epoch - 1
    raise RuntimeError("the stream ended")


def main() -> None:
    """Print milliseconds of unpacking beside plain loops, then latency and recovery on the emulated chip's clock."""
    logging.disable(logging.WARNING)
    fast_ms, plain_ms, assemble_ms = measure_unpacking()
    print("12-bit unpacking, 3 x 64 x 128         ms   ratio")
    print(f"  vectorised, headers skipped     {fast_ms:7.3f}       1")
    print(f"  plain loops                     {plain_ms:7.3f}  {plain_ms / fast_ms:6.0f}")
    print(f"  bursts to frame, headers checked{assemble_ms:7.3f}  {assemble_ms / fast_ms:6.1f}")
    print("emulated chip, default waveform   next frame ms  latency ms  restarts")
    for fault in ("", *FAULTS):
        back_ms, latency_ms, restarts = measure_fault(fault)
        print(f"  {fault or 'no fault':<31} {back_ms:13.1f} {latency_ms:11.2f} {restarts:9d}")
    logging.disable(logging.NOTSET)


if __name__ == "__main__":
    main()
