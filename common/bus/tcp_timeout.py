"""Connections whose other end is gone end with Zenoh's lease, by a kernel option that Zenoh has no setting for.

Zenoh gives a silent link up after the lease, but its close waits up to 10 s for what was not acknowledged. When the
neighbour comes back meanwhile, the late end of the old link takes the new one with it: about 1 s without a message,
seconds after all was well again.
"""

from __future__ import annotations

import ctypes
import os
import socket


def set_tcp_user_timeout(seconds: float) -> None:
    """Let the kernel drop every TCP connection of this process that has had no acknowledgement for so long."""
    value = ctypes.c_uint(round(seconds * 1e3))
    for name in os.listdir("/proc/self/fd"):
        # On whatever is no TCP socket this fails, and nothing has happened.
        ctypes.CDLL(None).setsockopt(
            int(name), socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, ctypes.byref(value), ctypes.sizeof(value)
        )
