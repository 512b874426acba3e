"""A link with delay, for kernels without netem: two TAP devices, each frame is passed on late.

    python -m spotter_tools.drill.delayed_link slow-a slow-b 0.1        # needs root; prints "ready" once it relays

The kernel hands a TAP device whole frames with their checksums done, so what comes out is what went in.
"""

from __future__ import annotations

import fcntl
import os
import select
import struct
import sys
from collections import deque
from typing import NoReturn

from common.clock import monotonic_s

FRAME_BYTES = 65_536
_TUNSETIFF, _IFF_TAP, _IFF_NO_PI = 0x400454CA, 0x0002, 0x1000  # linux/if_tun.h


def open_tap(name: str) -> int:
    """A file descriptor that reads and writes the Ethernet frames of a TAP device.

    Raises:
        OSError: not permitted, or the device is in use.
    """
    device = os.open("/dev/net/tun", os.O_RDWR)
    fcntl.ioctl(device, _TUNSETIFF, struct.pack("16sH14x", name.encode(), _IFF_TAP | _IFF_NO_PI))
    return device


def relay(one: int, other: int, delay_s: float) -> NoReturn:
    """Pass frames both ways, each ``delay_s`` after it came, in order."""
    waiting: deque[tuple[float, int, bytes]] = deque()
    leads_to = {one: other, other: one}
    while True:
        left_s = max(0.0, waiting[0][0] - monotonic_s()) if waiting else None
        ready, _, _ = select.select([one, other], [], [], left_s)
        for source in ready:
            waiting.append((monotonic_s() + delay_s, leads_to[source], os.read(source, FRAME_BYTES)))
        while waiting and waiting[0][0] <= monotonic_s():
            _, sink, frame = waiting.popleft()
            os.write(sink, frame)


def main() -> None:
    """The command above."""
    one, other = (open_tap(name) for name in sys.argv[1:3])
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    relay(one, other, float(sys.argv[3]))


if __name__ == "__main__":
    main()
