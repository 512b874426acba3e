"""A ROS 2 cloud of 200 000 points, 10 times a second: what it costs, and how late and how complete it arrives.

    python -m benchmarks.system.ros2

A driver in a process of its own publishes through a router in a third one, all on loopback; here the clouds are read as
the roadside service reads them. Beside it each step by itself, as a ratio to one plain copy of the same bytes.
"""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import zenoh

from common.bus.session import build as build_config
from common.bus.session import open_session
from common.bus.status import Report
from common.clock import utc_ns
from common.config import ZenohConfig
from common.pacing import ticks
from common.ros2.keys import SENSOR_DATA
from common.ros2.node import Node
from common.ros2.types import build, from_cdr, header, to_cdr
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.input.pointcloud2 import points_of_message
from services.infra_lidar.input.source import open_source
from spotter_tools.ports import free_port

POINTS, RATE_HZ, SECONDS = 200_000, 10.0, 15.0
CLOUD = "sensor_msgs/msg/PointCloud2"
RECORD = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"), ("time", "<f4")])
DATATYPES = {"<f4": 7, "<u2": 4}


def cloud(stamp_ns: int) -> Any:
    """In the layout of the Velodyne driver: 22 bytes a point."""
    dice, rows, about = np.random.default_rng(1), np.zeros(POINTS, RECORD), RECORD.fields or {}
    for axis in "xyz":
        rows[axis] = dice.uniform(-50, 50, POINTS)
    rows["ring"] = np.arange(POINTS) % 128
    fields = [
        build("sensor_msgs/msg/PointField", name=n, offset=at, datatype=DATATYPES[kind.str], count=1)
        for n, (kind, at) in about.items()
    ]
    return build(
        CLOUD, header=header(stamp_ns, "pole"), height=1, width=POINTS, fields=fields, point_step=RECORD.itemsize,
        row_step=rows.nbytes, data=np.frombuffer(rows.tobytes(), np.uint8), is_dense=True,
    )  # fmt: skip


def route(endpoint: str) -> None:
    """The router's process."""
    with zenoh.open(build_config(ZenohConfig(mode="router", namespace="", connect=(), listen=(endpoint,)))):
        threading.Event().wait()


def drive(endpoint: str) -> None:
    """The driver's process."""
    with open_session(ZenohConfig(namespace="", connect=(endpoint,))) as session:
        publish, message = Node(session, "driver").publisher("/points", CLOUD, SENSOR_DATA), cloud(utc_ns())
        for _ in ticks(1.0 / RATE_HZ):
            message.header = header(utc_ns(), "pole")
            publish(message)


def best_ms(call: Callable[[], object], repeats: int = 20) -> float:
    """Milliseconds a call, the best of some."""
    spent = []
    for _ in range(repeats):
        begun_s = time.perf_counter()
        call()
        spent.append(time.perf_counter() - begun_s)
    return min(spent) * 1e3


def steps() -> None:
    """Each step alone."""
    message = cloud(utc_ns())
    data = to_cdr(message)
    copied_ms = best_ms(lambda: bytearray(data))
    print(f"{POINTS} points, {len(data) / 1e6:.1f} MB; a plain copy takes {copied_ms:.2f} ms")
    for name, call in {
        "write CDR": lambda: to_cdr(message),
        "read CDR": lambda: from_cdr(data, CLOUD),
        "cloud to points": lambda: points_of_message(message),
    }.items():
        spent_ms = best_ms(call)
        print(f"  {name:<18}{spent_ms:7.2f} ms   {spent_ms / copied_ms:5.1f} copies")


def stream(endpoint: str) -> None:
    """Read for some seconds and say what came."""
    report = Report("infra_lidar")
    config = InfraLidarConfig(source="ros2:/points", zenoh=ZenohConfig(namespace="site", connect=(endpoint,)))
    late_ms: list[float] = []
    for k, (stamp_ns, _) in enumerate(open_source(config, report)):
        if k == 0:
            begun_s, begun_cpu_s = time.monotonic(), time.process_time()
        late_ms.append((utc_ns() - stamp_ns) / 1e6)
        if time.monotonic() - begun_s > SECONDS:
            break
    spent_s, cpu_s = time.monotonic() - begun_s, time.process_time() - begun_cpu_s
    status = report.snapshot()
    lost = status.counters.get("message lost", 0)
    print(f"{(len(late_ms) - 1) / spent_s:.2f} clouds a second, {lost} lost, {status.dropped} dropped for newer ones")
    print(f"stamp to points: median {np.median(late_ms):.1f} ms, 95 % {np.percentile(late_ms, 95):.1f} ms")
    print(f"the reader takes {100 * cpu_s / spent_s:.0f} % of a core")


def main() -> None:
    """The command above."""
    if len(sys.argv) == 3:
        {"route": route, "drive": drive}[sys.argv[1]](sys.argv[2])
        return
    steps()
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    others = [
        subprocess.Popen([sys.executable, "-m", "benchmarks.system.ros2", part, endpoint])
        for part in ("route", "drive")
    ]
    try:
        stream(endpoint)
    finally:
        for process in others:
            process.kill()
            process.wait()


if __name__ == "__main__":
    main()
