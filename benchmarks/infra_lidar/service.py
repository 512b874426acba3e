"""The roadside lidar's service as a whole: VLS-128 packets over UDP in, tracks over Zenoh out.

    python -m benchmarks.infra_lidar.service                 some 25 seconds for each row
    python -m benchmarks.infra_lidar.service --seconds 120   two minutes for each

A process of its own sends the packets of a simulated junction in real time, as the sensor does; the service runs as in
the field and learns its background in the first five seconds. What comes after that counts. Latency is from the last
packet of a revolution (as the receive thread got it) to the publication of its tracks, and to their arrival here.
"""

from __future__ import annotations

import argparse
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import zenoh

from benchmarks.infra_lidar.vls128_packets import FIRINGS, revolution_packets
from benchmarks.onboard.dashboard import free_port, pause, process
from common.bus.session import build, open_session
from common.clock import utc_ns
from common.codec import decode
from common.config import ZenohConfig
from common.messages import ObjectTracks, ServiceStatus
from common.topics import INFRA_TRACKS
from services.infra_lidar.input.velodyne import CYCLE_US
from spotter_sim import lidar128

START_S, LEARN_S, SETTLE_S = 6.0, 5.0, 12.0  # imports and kernels; the background; until it counts
REVOLUTIONS, FIRST_T_S = 20, 3.0
COLUMNS = {10: 1809, 20: 903}


@dataclass
class Received:
    """The messages of one instance from ``from_ns`` on."""

    host: str
    from_ns: int = 2**63
    tracks: list[ObjectTracks] = field(default_factory=list)
    arrived_ns: list[int] = field(default_factory=list)
    status: list[ServiceStatus] = field(default_factory=list)

    def listen(self, session: zenoh.Session) -> None:
        """Subscribe to the tracks and the status of ``host``."""
        session.declare_subscriber(INFRA_TRACKS.key(self.host), self._on_tracks)
        session.declare_subscriber(f"{self.host}/infra_lidar/status", self._on_status)

    def _on_tracks(self, sample: zenoh.Sample) -> None:
        now_ns = utc_ns()
        if now_ns > self.from_ns:
            self.arrived_ns.append(now_ns)
            self.tracks.append(decode(sample.payload.to_bytes(), ObjectTracks))

    def _on_status(self, sample: zenoh.Sample) -> None:
        if utc_ns() > self.from_ns:
            self.status.append(decode(sample.payload.to_bytes(), ServiceStatus))


def send(port: int, rate_hz: int, seconds: float) -> None:
    """The sensor: the same two seconds again and again, packet by packet when each is due. Prints what it sent."""
    revolutions = [
        revolution_packets(lidar128.scan("crossing", FIRST_T_S + k / rate_hz, COLUMNS[rate_hz]), COLUMNS[rate_hz])
        for k in range(REVOLUTIONS)
    ]
    packets = [packet for revolution in revolutions for packet in revolution]
    period_s = FIRINGS * CYCLE_US * 1e-6
    print("ready", flush=True)
    sys.stdin.readline()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        out.connect(("127.0.0.1", port))
        started_s, sent = time.monotonic(), 0
        while sent * period_s < seconds:
            left_s = started_s + sent * period_s - time.monotonic()
            if left_s > 0:
                time.sleep(left_s)
            packet, time_us = packets[sent % len(packets)], round(sent * period_s * 1e6) % 3_600_000_000
            packet[1200:1204] = np.frombuffer(time_us.to_bytes(4, "little"), np.uint8)
            with suppress(ConnectionRefusedError):  # nobody listens yet, or no longer
                out.send(packet.data)
            sent += 1
    print(sent, flush=True)


@contextmanager
def sender(port: int, rate_hz: int, seconds: float) -> Iterator[subprocess.Popen[str]]:
    """The sensor as a process, waiting for a line before it begins."""
    command = [sys.executable, "-m", "benchmarks.infra_lidar.service", "--send", *map(str, (port, rate_hz, seconds))]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[2]
    ) as child:
        try:
            assert child.stdout is not None
            child.stdout.readline()
            yield child
        finally:
            child.kill()


def run(rate_hz: int, seconds: float, instances: int) -> list[Received]:
    """Let ``instances`` sensors and services run for the time to settle and ``seconds`` more."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    received = [Received(f"infra{number}") for number in range(instances)]
    with ExitStack() as stack:
        router = ZenohConfig(mode="router", connect=(), listen=(endpoint,), namespace="")
        stack.enter_context(zenoh.open(build(router)))
        session = stack.enter_context(open_session(ZenohConfig(connect=(endpoint,))))
        sensors = []
        for one in received:
            port = free_port()
            sensors.append(stack.enter_context(sender(port, rate_hz, SETTLE_S + seconds + 30.0)))
            stack.enter_context(process(
                "spotter-infra-lidar", "--source", f"velodyne://127.0.0.1:{port}", "--set", f'host="{one.host}"',
                "--set", f'zenoh.connect=["{endpoint}"]', "--set", f"background.learn_s={LEARN_S}",
                "--set", "background.min_frames=40",
            ))  # fmt: skip
            one.listen(session)
        pause(START_S)
        for sensor in sensors:
            assert sensor.stdin is not None
            sensor.stdin.write("go\n")
            sensor.stdin.flush()
        pause(SETTLE_S)
        for one in received:
            one.from_ns = utc_ns()
        pause(seconds)
    return received


def report(rate_hz: int, one: Received) -> float:
    """Print the figures of an instance; returns its share of a core."""
    if len(one.status) < 2 or not one.tracks:
        print(f"  {one.host}: no messages received")
        return 0.0
    first, last, stamps = one.status[0], one.status[-1], [m.stamp_ns for m in one.tracks]
    span_s = (last.sent_ns - first.sent_ns) / 1e9
    cpu = (last.cpu_s - first.cpu_s) / span_s
    p50, p99 = np.percentile([(m.sent_ns - m.received_ns) / 1e6 for m in one.tracks], (50, 99))
    a50, a99 = np.percentile(
        [(a - m.received_ns) / 1e6 for a, m in zip(one.arrived_ns, one.tracks, strict=True)], (50, 99)
    )
    missing = one.tracks[-1].seq - one.tracks[0].seq + 1 - len(stamps)
    expected = (stamps[-1] - stamps[0]) / 1e9 * rate_hz + 1.0
    print(
        f"  {one.host} at {rate_hz} Hz, {span_s:.0f} s, {one.tracks[-1].points_in} points, "
        f"{len(one.tracks[-1].tracks)} tracks: published {p50:.2f} ms after the last packet (p99 {p99:.2f}), "
        f"here after {a50:.2f} (p99 {a99:.2f}); processor {cpu:.1%} of a core; "
        f"memory {first.rss_mb:.0f} to {last.rss_mb:.0f} MB\n"
        f"    {len(stamps)} of {expected:.0f} revolutions, dropped {last.dropped - first.dropped}, "
        f"messages missing {missing}, rejected {last.bad_input - first.bad_input}; "
        + "; ".join(sorted({f"{m.state} {m.reason}".strip() for m in one.tracks}))
    )
    return cpu


def main() -> None:
    """One sensor at 10 and at 20 Hz, then three at 10 Hz; or, with --send, the sensor itself."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=12.0)
    parser.add_argument("--rates", type=int, nargs="*", default=[10, 20])
    parser.add_argument("--instances", type=int, default=3)
    parser.add_argument("--send", nargs=3)
    asked = parser.parse_args(sys.argv[1:])
    if asked.send:
        send(int(asked.send[0]), int(asked.send[1]), float(asked.send[2]))
        return
    share = {rate_hz: report(rate_hz, run(rate_hz, asked.seconds, 1)[0]) for rate_hz in asked.rates}
    if share.get(10):
        print(f"  by its share of the processor one core carries {1.0 / share[10]:.1f} such sensors at 10 Hz")
    if asked.instances > 1:
        print(f"  {asked.instances} at once:")
        for one in run(10, min(asked.seconds, 60.0), asked.instances):
            report(10, one)


if __name__ == "__main__":
    main()
