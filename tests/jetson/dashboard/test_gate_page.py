"""The gate's line on the page: what it says, that it is silent, and nothing where there is no gate."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import pytest

from common.bus.runtime import Service
from common.config import ServiceConfig, ZenohConfig
from common.messages import GateState
from common.topics import GATE_STATE

pytestmark = [pytest.mark.system, pytest.mark.slow]


def state() -> GateState:
    return GateState(
        stamp_ns=time.time_ns(), permission="SLOW", limit_mps=0.5, cause="verdict", because="near", left_s=0.0,
        acknowledge=False, verdict_seq=1, verdict_age_s=0.01, outputs={}, state="degraded", reason="alone",
    )  # fmt: skip


def test_the_gate_speaks_and_falls_silent(
    browser: Any, module_router: str, start_dashboard_at: Callable[..., Any]
) -> None:
    browser.open(str(start_dashboard_at(module_router).url))
    browser.wait("document.getElementById('gate').hidden")
    stop = threading.Event()
    with Service("gate", ServiceConfig(host="jetson0", zenoh=ZenohConfig(connect=(module_router,)))) as service:
        publish = service.publisher(GATE_STATE)

        def speak() -> None:
            while not stop.wait(0.05):
                publish(state())

        thread = threading.Thread(target=speak)
        thread.start()
        text = "document.getElementById('gate').textContent"
        browser.wait(f"{text} == 'Gate: SLOW, at most 0.5 m/s: near (alone)'")
        stop.set()
        thread.join()
        browser.wait(f"{text}.startsWith('Gate: silent for')")
