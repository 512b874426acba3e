"""How fast the gate acts: from a verdict handed to the network to its frame at the actuator, over real processes.

    python -m benchmarks.onboard.gate

Router and gate are processes of their own, the actuator is the firmware's logic behind a pseudo-terminal. The plain
reference in the same run: the same message to a subscriber that does nothing.
"""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from contextlib import ExitStack

import numpy as np

from common.bus.runtime import Service
from common.bus.session import open_session
from common.clock import monotonic_s, utc_ns
from common.config import ServiceConfig, ZenohConfig
from common.host.process_plan import Plan, router_child
from common.messages import Verdict
from common.topics import FUSION_VERDICT
from services.jetson.gate.emulator import EmulatedActuator
from spotter_tools.ports import free_port

PERIOD_S, COUNT = 0.02, 1000


def verdict(seq: int) -> Verdict:
    """One that lets the vehicle go; now and then SLOW, so that every path is in."""
    slow = seq % 50 == 0
    return Verdict(
        stamp_ns=utc_ns(), level="CAUTION" if slow else "SAFE", rule="R0-clear", because="nothing near", inputs={},
        confirmed=False, suppressed=False, advisory=None, blind=False, permission="SLOW" if slow else "GO",
        source_kind="live",
    )  # fmt: skip


def measure() -> tuple[np.ndarray, np.ndarray]:
    """Seconds from the put of a verdict to its frame at the actuator, and to a plain subscriber's callback."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    config = ZenohConfig(connect=(endpoint,))
    sent_s, heard_s = np.zeros(COUNT), np.zeros(COUNT)
    with ExitStack() as stack:
        router = subprocess.Popen(router_child(Plan(listen=(endpoint,))).command, stderr=subprocess.DEVNULL)
        stack.callback(router.terminate)
        actuator = stack.enter_context(EmulatedActuator())
        settings = (f'outputs=["serial:{actuator.device}"]', f"zenoh.connect={json.dumps([endpoint])}")
        options = [word for text in settings for word in ("--set", text)]
        gate = subprocess.Popen([sys.executable, "-m", "services.jetson.gate", *options], stderr=subprocess.DEVNULL)
        stack.callback(gate.terminate)
        listener = stack.enter_context(open_session(config))
        arrived = iter(range(COUNT))

        def hear(_: object) -> None:
            heard_s[next(arrived)] = monotonic_s()

        fusion = stack.enter_context(Service("fusion", ServiceConfig(host="jetson0", zenoh=config)))
        publish = fusion.publisher(FUSION_VERDICT)
        kept = listener.declare_subscriber(FUSION_VERDICT.key("jetson0"), hear)
        while not publish.has_subscribers or not actuator.accepted_s:
            threading.Event().wait(0.05)
        for seq in range(COUNT):
            sent_s[seq] = monotonic_s()
            publish(verdict(seq))
            threading.Event().wait(PERIOD_S)
        threading.Event().wait(0.2)
        kept.undeclare()
        acted_s = np.array([actuator.verdicts_s.get(seq, np.nan) for seq in range(COUNT)])
    return (acted_s - sent_s)[1:], (heard_s - sent_s)[1:]


def main() -> None:
    """The command above."""
    acted_s, heard_s = measure()
    print(f"   {np.isnan(acted_s).sum()} of {len(acted_s)} verdicts never came as a frame")
    for name, times_s in (("plain subscriber", heard_s), ("frame at the actuator", acted_s)):
        p50, p99, worst = (np.nanquantile(times_s, q) * 1e3 for q in (0.5, 0.99, 1.0))
        print(f"   verdict put -> {name:<22} p50 {p50:5.2f} ms  p99 {p99:5.2f} ms  worst {worst:5.2f} ms")
    print(f"   ratio of the medians {np.nanmedian(acted_s) / np.nanmedian(heard_s):.1f}")


if __name__ == "__main__":
    main()
