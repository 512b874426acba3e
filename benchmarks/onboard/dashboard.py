"""What twenty lookers cost: verdict latency with and without clients of the dashboard, and the server's memory.

    python -m benchmarks.onboard.dashboard

A real router, fusion and dashboard as processes; three sensors at their nominal rates from this process, with scans of
450 beams and 15 roadside tracks, so that a snapshot is as large as in the demo. Twenty websocket clients at 10 Hz
read everything, from a process of their own; one of them reads 50 kB/s, no more. Rounds without and with clients
alternate, so that whatever else this machine does falls on both.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import zenoh

from benchmarks.onboard.fusion import InputToVerdict, publishers
from common.bus.session import build, open_session
from common.clock import utc_ns
from common.codec import encode
from common.config import ZenohConfig
from common.messages import LaserScan, ObjectTrack, ObjectTracks
from common.topics import INFRA_TRACKS, LIDAR_SCAN
from spotter_tools.ports import free_port

CLIENTS = 20
RATE_HZ = 10
THROTTLED_BYTES_PER_S = 50_000
ROUNDS = 4
ROUND_S = 8.0
WISH = json.dumps({"rate_hz": RATE_HZ, "products": ["*"]})


def main() -> None:
    """The command above."""
    if "--clients" in sys.argv:
        look(int(sys.argv[-1]))
        return
    endpoint, port = f"tcp/127.0.0.1:{free_port()}", free_port()
    router = ZenohConfig(mode="router", connect=(), listen=(endpoint,), namespace="")
    with ExitStack() as stack:
        stack.enter_context(zenoh.open(build(router)))
        session = stack.enter_context(open_session(ZenohConfig(connect=(endpoint,))))
        to_router = f'zenoh.connect=["{endpoint}"]'
        stack.enter_context(process("spotter-fusion", "--set", to_router))
        server = stack.enter_context(process("spotter-dashboard", "--set", to_router, "--set", f"server.port={port}"))
        stack.enter_context(publishers(endpoint, 1.0))
        stack.enter_context(scenery(session))
        wait_for(port)
        measure(session, server, port)


def measure(session: zenoh.Session, server: subprocess.Popen[bytes], port: int) -> None:
    """Rounds without and with a crowd of clients in turn: input to verdict, and the server's memory."""
    latencies_ms: dict[bool, list[float]] = {False: [], True: []}
    memory_mb: list[float] = []
    watch = InputToVerdict(session)
    pause(3.0)
    print(f"server memory before any client: {resident_mb(server.pid):.0f} MB")
    for turn in range(2 * ROUNDS):
        crowd = turn % 2 == 1
        with ExitStack() as stack:
            if crowd:
                stack.enter_context(crowd_of(port))
            pause(1.0)
            watch.restart()
            pause(ROUND_S)
            latencies_ms[crowd] += watch.latencies_ms
            if crowd:
                memory_mb.append(resident_mb(server.pid))
    watch.close()
    report(latencies_ms, memory_mb)


def report(latencies_ms: dict[bool, list[float]], memory_mb: list[float]) -> None:
    """Print both distributions, their ratio and the memory of each round."""
    p99_ms = {}
    for crowd, name in ((False, "no client"), (True, f"{CLIENTS} clients, one at 50 kB/s")):
        p50, p99_ms[crowd] = np.percentile(latencies_ms[crowd], (50, 99))
        print(f"{name:<30} p50 {p50:6.2f} ms  p99 {p99_ms[crowd]:6.2f} ms  ({len(latencies_ms[crowd])} inputs)")
    print(f"p99 with clients / without: {p99_ms[True] / p99_ms[False]:.2f}   (load {os.getloadavg()[0]:.1f})")
    print("server memory after each round with clients: " + ", ".join(f"{mb:.0f} MB" for mb in memory_mb))


@contextmanager
def scenery(session: zenoh.Session) -> Iterator[None]:
    """Scans and roadside tracks at 10 Hz, as large as those of the demo; fusion does not decide on them."""
    random, stop = np.random.default_rng(0), threading.Event()
    angles_rad = np.linspace(-np.pi, np.pi, 450, dtype=np.float32)

    def put() -> None:
        while not stop.wait(0.1):
            ranges_m = random.uniform(0.1, 12, 450).astype(np.float32)
            confidence = random.integers(0, 255, 450, np.uint8)
            scan = LaserScan(stamp_ns=utc_ns(), angles_rad=angles_rad, ranges_m=ranges_m, confidence=confidence)
            session.put(LIDAR_SCAN.key("jetson0"), encode(scan))
            tracks = [road_user(index, random.normal(size=6)) for index in range(15)]
            session.put(INFRA_TRACKS.key("roadside"), encode(ObjectTracks(stamp_ns=utc_ns(), tracks=tracks)))

    thread = threading.Thread(target=put)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def road_user(track_id: int, numbers: np.ndarray) -> ObjectTrack:
    """A roadside track made of six random numbers."""
    x, y, z, vx, vy, yaw = (float(number) for number in numbers)
    covariance = np.outer(numbers, numbers).tolist()
    return ObjectTrack(
        track_id=track_id, label="car", label_confidence=0.9, position_m=(x, y, z), velocity_mps=(vx, vy, 0.0),
        covariance=covariance, size_m=(4.0, 1.8, 1.5), yaw_rad=yaw, age_s=2.0, score=0.8, state="confirmed", points=99,
    )  # fmt: skip


@contextmanager
def crowd_of(port: int) -> Iterator[None]:
    """A process with all clients, connected when the block begins."""
    command = [sys.executable, "-m", "benchmarks.onboard.dashboard", "--clients", str(port)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[2]) as child:
        try:
            assert child.stdout is not None
            child.stdout.readline()  # all are connected
            yield
        finally:
            child.send_signal(signal.SIGTERM)
            output, _ = child.communicate()
            print(f"  {output.strip()}")


def look(port: int) -> None:
    """Nineteen clients that read all they get and one that reads 50 kB/s; at the end, what they have read."""
    read = [0] * CLIENTS
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    sockets = [open_websocket(port, small_buffer=index == 0) for index in range(CLIENTS)]
    threads = [
        threading.Thread(target=drain, args=(sockets[i], read, i, THROTTLED_BYTES_PER_S if i == 0 else 0, stop))
        for i in range(CLIENTS)
    ]
    for thread in threads:
        thread.start()
    started_s = time.monotonic()
    print("connected", flush=True)
    stop.wait()
    span_s = time.monotonic() - started_s
    for thread in threads:
        thread.join()
    fast, slow = np.median(read[1:]) / span_s / 1000, read[0] / span_s / 1000
    print(f"each client read {fast:.0f} kB/s, the throttled one {slow:.0f} kB/s")


def drain(client: socket.socket, read: list[int], index: int, limit: int, stop: threading.Event) -> None:
    """Read frames as bytes; ``limit`` bytes a second, 0 for all there is."""
    client.settimeout(0.2)
    while not stop.is_set():
        try:
            got = len(client.recv(limit // 10 if limit else 1 << 16))
        except TimeoutError:
            continue
        if not got:
            return
        read[index] += got
        if limit:
            stop.wait(got / limit)


def open_websocket(port: int, small_buffer: bool) -> socket.socket:
    """A websocket by hand: a library would read ahead, and then nothing would be throttled."""
    client = socket.socket()
    if small_buffer:
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    client.connect(("127.0.0.1", port))
    client.sendall(
        (
            f"GET /ws HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n\r\n"
        ).encode()
    )
    answer = b""
    while b"\r\n\r\n" not in answer:
        answer += client.recv(1)
    assert answer.startswith(b"HTTP/1.1 101"), answer
    wish = WISH.encode()
    client.sendall(struct.pack("!BB4s", 0x81, 0x80 | len(wish), bytes(4)) + wish)  # masked with zeros
    return client


@contextmanager
def process(script: str, *arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """A Spotter service that lives as long as the block."""
    command = [str(Path(sys.executable).with_name(script)), *arguments]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as child:
        try:
            yield child
        finally:
            child.send_signal(signal.SIGTERM)


def resident_mb(pid: int) -> float:
    """Resident memory of a process in MB."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def wait_for(port: int) -> None:
    """Until the page answers."""
    for _ in range(300):
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=1):
                return
        except OSError:
            pause(0.1)
    raise SystemExit("the dashboard did not start")


def pause(seconds: float) -> None:
    """Let the processes run for a while."""
    threading.Event().wait(seconds)


if __name__ == "__main__":
    main()
