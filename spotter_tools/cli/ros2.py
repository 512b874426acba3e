"""`spotter ros2`: the running system as standard topics of ROS 2, for `ros2 topic list`, RViz and Autoware."""

from __future__ import annotations

import signal
import sys
import threading
from typing import Annotated

import typer

from common.bus.session import close_session, open_session
from common.config import ConfigError
from spotter_tools.cli.connect import DEFAULT_ENDPOINT, GIVE_UP_AFTER_S, Connect, Namespace, bus
from spotter_tools.cli.fail import fail, needs_extra

TELL_S = 1.0


def ros2(
    router: Annotated[
        str, typer.Option("--ros", help="The ROS machine's router, e.g. tcp/10.0.0.9:7447; default: the same as ours.")
    ] = "",
    domain: Annotated[int, typer.Option(min=0, max=232, help="ROS_DOMAIN_ID.")] = 0,
    autoware: Annotated[
        bool, typer.Option(help="Roadside tracks on /perception/object_recognition/tracking/objects too.")
    ] = False,
    tf: Annotated[bool, typer.Option("--tf", help="The vehicle on /tf and its sensors on /tf_static.")] = False,
    seconds: Annotated[float, typer.Option(min=0.0, help="End after so long; 0 = on Ctrl-C.")] = 0.0,
    connect: Connect = DEFAULT_ENDPOINT,
    namespace: Namespace = "",
) -> None:
    """Publish the bus into a ROS 2 domain (rmw_zenoh) until Ctrl-C; ROS need not be installed here."""
    try:
        from common.ros2.node import Node, node_config
        from spotter_tools.ros2.bridge import Bridge
        from spotter_tools.ros2.table import AUTOWARE_ROW, ROWS, TF_ROW
    except ImportError:
        needs_extra("this needs", "ros2")
    if connect.startswith("tls/") and not router:
        fail(
            "--ros: give the ROS machine's router: a site's router lets ROS through to programs on its own host only "
            "([ros2] domains in site.toml, docs/ros2.md)", code=2,
        )  # fmt: skip
    rows = (*ROWS, *([AUTOWARE_ROW] if autoware else []), *([TF_ROW] if tf else []))
    stop = threading.Event()
    for signum in (signal.SIGINT, signal.SIGTERM):
        signal.signal(signum, lambda *_: stop.set())
    with bus(connect, namespace) as session:
        there = tuple((router or connect).split(","))
        try:
            ros = open_session(node_config(there), give_up_after_s=GIVE_UP_AFTER_S)
        except (ConnectionError, ConfigError) as error:
            fail(f"--ros: {error}")
        bridge = Bridge(session, Node(ros, "spotter", domain), rows, sensors=tf)
        worker = threading.Thread(target=bridge.run, args=(stop,), name="bridge", daemon=True)
        worker.start()
        shown: set[str] = set()
        waited_s = 0.0
        while not stop.wait(TELL_S) and not (seconds and waited_s >= seconds):
            waited_s += TELL_S
            for line in bridge.lines():
                if line.name not in shown:
                    shown.add(line.name)
                    sys.stderr.write(f"  {line.name}  {line.row.type}  from {line.key}\n")
            for why in [one for one in list(bridge.refused) if one not in shown]:
                shown.add(why)
                sys.stderr.write(f"  not published: {why}\n")
        stop.set()
        worker.join()
        bridge.close()
        close_session(ros)
        for why, count in sorted(bridge.refused.items()):
            sys.stderr.write(f"  not published, {count} times: {why}\n")
