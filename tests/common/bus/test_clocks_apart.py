"""Hosts whose clocks are far apart: messages pass, and the log stays readable."""

from __future__ import annotations

import datetime as dt
import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest
import zenoh

from common.bus.session import open_session
from common.config import ZenohConfig

A_YEAR = dt.timedelta(days=365)


@pytest.fixture
def router(free_ports: Callable[[], int]) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """`spotter router` as a process of its own, which writes to stdout what Zenoh logs."""
    endpoint = f"tcp/127.0.0.1:{free_ports()}"
    command = [sys.executable, "-m", "spotter_tools.cli", "router", "--listen", endpoint]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        yield endpoint, process
        process.kill()


@pytest.mark.system
def test_a_router_that_is_a_year_behind_logs_no_error_a_message(
    router: tuple[str, subprocess.Popen[str]], until: Callable[..., None]
) -> None:
    endpoint, process = router
    config = ZenohConfig(connect=(endpoint,))
    plain, stamping = (ZenohConfig(connect=(endpoint,), extra={"timestamping/enabled": on}) for on in (False, True))
    received: list[bytes] = []
    with open_session(config) as there, open_session(plain) as here, open_session(stamping) as clock:
        there.declare_subscriber("*/radar/tracks", lambda sample: received.append(sample.payload.to_bytes()))
        stamp = zenoh.Timestamp(dt.datetime.now(dt.UTC) + A_YEAR, clock.new_timestamp().get_id())

        def came_through() -> bool:
            here.put("pi0/radar/tracks", b"tracks", timestamp=stamp)
            return b"tracks" in received

        until(came_through)
    process.terminate()
    said, _ = process.communicate(timeout=30)
    assert "Error treating timestamp" not in said, said
