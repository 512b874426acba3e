"""A ROS 2 program that is none of ours: it publishes a street's clouds, or listens to any topic, without ROS.

python examples/ros2_peer.py points [--router 127.0.0.1:7447] [--topic /points] [--seconds 20] [--columns 1800]
python examples/ros2_peer.py listen TOPIC TYPE [--router 127.0.0.1:7447] [--count 5] [--seconds 20]

Keys, tokens, attachments, hashes and CDR are those of zenoh-ros2-sdk (extra ``dev``), which does not know Spotter. It
is given the definitions of the messages, which it would fetch from the network otherwise; the street is the simulated
one.
"""

from __future__ import annotations

import argparse
import os
import sys
import threading
import time
from typing import Any

import numpy as np

os.environ.setdefault("ZENOH_CONFIG_OVERRIDE", 'mode="client";scouting/gossip/enabled=false;listen/endpoints=[]')

from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber
from zenoh_ros2_sdk.utils import compute_type_hash_from_msg

from common.ros2.types import definition

CLOUD = "sensor_msgs/msg/PointCloud2"
PERIOD_S = 0.1
LONGEST = 2000  # characters of a message that are printed


def about(type_: str, router: str) -> dict[str, Any]:
    """What the library needs to know of a type, and where the router is."""
    own, *parts = (text := definition(type_)).split("=" * 80 + "\n")
    needed = {}
    for part in parts:
        head, _, body = part.partition("\n")
        package, last = head.removeprefix("MSG: ").split("/")
        needed[f"{package}/msg/{last}"] = body
    address, _, port = router.rpartition(":")
    hash_ = compute_type_hash_from_msg(type_, own, needed)
    return {"msg_definition": text, "type_hash": hash_, "router_ip": address, "router_port": int(port)}


def publish_points(router: str, topic: str, seconds: float, columns: int) -> None:
    """The simulated street as a driver publishes it: 10 clouds a second of x, y, z, intensity and ring."""
    from spotter_sim import lidar128, world

    scenario = world.scenario_named("crossing")
    publisher = ROS2Publisher(topic, CLOUD, node_name="street", **about(CLOUD, router))
    types = publisher.session_mgr.store.types
    field = types["sensor_msgs/msg/PointField"]
    record = np.dtype([(name, "<f4") for name in ("x", "y", "z", "intensity")] + [("ring", "<u2")])
    fields = [field(n, 4 * k, 7, 1) for k, n in enumerate(("x", "y", "z", "intensity"))] + [field("ring", 16, 4, 1)]
    begin_s = time.monotonic()
    while (now_s := time.monotonic() - begin_s) < seconds:
        stamp_ns = time.time_ns()
        scan = lidar128.scan(scenario, now_s, columns)
        rows = np.empty(len(scan.xyz), record)
        rows["x"], rows["y"], rows["z"] = scan.xyz.T
        rows["intensity"], rows["ring"] = scan.intensity, scan.ring
        stamp = types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
        publisher.publish(
            header=types["std_msgs/msg/Header"](stamp, "pole"), height=1, width=len(rows), fields=fields,
            is_bigendian=False, point_step=record.itemsize, row_step=rows.nbytes,
            data=np.frombuffer(rows.tobytes(), np.uint8), is_dense=True,
        )  # fmt: skip
        time.sleep(max(0.0, begin_s + now_s + PERIOD_S - time.monotonic()))


def listen(router: str, topic: str, type_: str, count: int, seconds: float) -> int:
    """Print the first messages; 0 if that many came in time."""
    left, done = [count], threading.Event()

    def show(message: Any) -> None:
        if left[0] > 0:
            left[0] -= 1
            sys.stdout.write(f"{topic}: {str(message)[:LONGEST]}\n")
            sys.stdout.flush()
        if left[0] == 0:
            done.set()

    ROS2Subscriber(topic, type_, show, node_name="listener", **about(type_, router))
    return 0 if done.wait(seconds) else 1


def main() -> int:
    """The command line above; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("points", "listen"))
    parser.add_argument("topic_and_type", nargs="*")
    parser.add_argument("--router", default="127.0.0.1:7447")
    parser.add_argument("--topic", default="/points")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--columns", type=int, default=1800)
    parser.add_argument("--count", type=int, default=5)
    given = parser.parse_args()
    if given.what == "points":
        publish_points(given.router, given.topic, given.seconds, given.columns)
        return 0
    if len(given.topic_and_type) != 2:
        parser.error("listen needs TOPIC and TYPE")
    return listen(given.router, *given.topic_and_type, given.count, given.seconds)


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    os._exit(code)  # a Zenoh thread would keep the process
