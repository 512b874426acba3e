"""Holds GPIO lines for the gate and lets go when the gate is silent: the firmware's logic as a process of this host.

python -m services.jetson.gate.guard CHIP ENABLE FULL|- high|low      # frames on stdin, reports on stdout
"""

from __future__ import annotations

import os
import select
import sys

from common.clock import monotonic_s
from services.jetson.gate.firmware.micropython.gate_receiver import GO, STOP, TICKS_MASK, GateReceiver
from services.jetson.gate.gpio_lines import LineError, Lines, open_lines

ROUND_S = 0.01
REPORT_EVERY_S = 0.05


def guard(lines: Lines, enable: int, full: int | None) -> None:
    """Obey the frames on stdin until it is closed."""
    receiver, reported, reported_s = GateReceiver(), STOP, 0.0
    os.set_blocking(sys.stdout.fileno(), False)
    while True:
        ready, _, _ = select.select([sys.stdin.fileno()], [], [], ROUND_S)
        data = os.read(sys.stdin.fileno(), 4096) if ready else None
        if data == b"":
            return
        now_s = monotonic_s()
        now_ms = int(now_s * 1e3) & TICKS_MASK
        accepted = False
        for byte in data or b"":
            accepted = receiver.feed(byte, now_ms) or accepted
        receiver.tick(now_ms)
        slow_is_stop = full is None and receiver.permission != GO
        values = {enable: receiver.permission != STOP and not slow_is_stop}
        lines.set(values if full is None else {**values, full: receiver.permission == GO})
        if accepted or receiver.permission != reported or now_s - reported_s >= REPORT_EVERY_S:
            reported, reported_s = receiver.permission, now_s
            try:
                os.write(sys.stdout.fileno(), receiver.report(0))
            except BlockingIOError:
                continue  # the gate does not read: it is frozen, and the frames will stop, too


def main() -> int:
    """The command above."""
    chip, enable, full, polarity = sys.argv[1:5]
    offsets = (int(enable),) if full == "-" else (int(enable), int(full))
    try:
        lines = open_lines(chip, offsets, active_low=polarity == "low")
    except LineError as error:
        sys.stderr.write(f"gate guard: {error}\n")
        return 1
    try:
        guard(lines, *offsets) if len(offsets) == 2 else guard(lines, offsets[0], None)
    except (KeyboardInterrupt, BrokenPipeError):
        return 0
    finally:
        lines.close()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
