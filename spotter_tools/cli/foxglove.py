"""`spotter foxglove`: the running system in Foxglove: 3-D scene, clouds, picture, transforms, log and plots.

Foxglove subscribes to what its panels show; only then are pictures and clouds asked for on the bus, so a laptop that
looks at a plot costs the hosts nothing.
"""

from __future__ import annotations

import signal
import sys
import threading
from typing import Annotated

import typer

from spotter_tools.cli.connect import DEFAULT_ENDPOINT, Connect, Namespace, bus
from spotter_tools.cli.fail import fail, needs_extra


def foxglove(
    port: Annotated[int, typer.Option(min=0, max=65535, help="Foxglove connects to ws://ADDRESS:PORT.")] = 8765,
    address: Annotated[str, typer.Option(help="0.0.0.0 lets other machines look; there is no password.")] = "127.0.0.1",
    connect: Connect = DEFAULT_ENDPOINT,
    namespace: Namespace = "",
) -> None:
    """Serve the bus to Foxglove until Ctrl-C."""
    try:
        from spotter_tools.cli.foxglove_bridge import Bridge
    except ImportError:
        needs_extra("the bridge needs", "foxglove")
    stop = threading.Event()
    for signum in (signal.SIGINT, signal.SIGTERM):
        signal.signal(signum, lambda *_: stop.set())
    with bus(connect, namespace) as session:
        try:
            bridge = Bridge(session, address, port)
        except (OSError, RuntimeError) as error:
            fail(f"--port {port}: cannot listen on {address}: {error}")
        sys.stderr.write(f"  Foxglove: open a connection to ws://{address}:{bridge.port}   (Ctrl-C ends)\n")
        stop.wait()
        bridge.close()
        if bridge.undecodable:
            sys.stderr.write(f"  {bridge.undecodable} messages could not be decoded\n")
