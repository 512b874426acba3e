"""Ends dead TCP connections when Zenoh's lease ends, by a kernel option that Zenoh has no setting for.

Zenoh closes a silent link after the lease, but the close waits up to 10 s for unacknowledged data. If the neighbour
reconnects meanwhile, the late end of the old link also ends the new one: about 1 s without a message, seconds after the
link had recovered.
"""

from __future__ import annotations

import ctypes
import os
import socket


def set_tcp_user_timeout(seconds: float) -> None:
    """Let the kernel drop every TCP connection of this process that had no acknowledgement for ``seconds``."""
    value = ctypes.c_uint(round(seconds * 1e3))
    for name in os.listdir("/proc/self/fd"):
        # setsockopt fails harmlessly on other descriptors.
        ctypes.CDLL(None).setsockopt(
            int(name), socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, ctypes.byref(value), ctypes.sizeof(value)
        )
