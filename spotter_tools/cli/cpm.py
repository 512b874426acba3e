"""`spotter cpm`: roadside tracks as ETSI Collective Perception Messages to a roadside unit's radio."""

from __future__ import annotations

import queue
import socket
import sys
import time
from typing import Annotated

import typer
import zenoh

from common.bus.published import why_silent
from common.codec import DecodeError, decode
from common.geodesy import NO_ORIGIN
from common.geojson import MAP_FRAME
from common.messages import ObjectTracks
from common.topics import INFRA_TRACKS
from spotter_tools.cli.connect import DEFAULT_ENDPOINT, Connect, Namespace, bus, own_name
from spotter_tools.cli.fail import fail, needs_extra
from spotter_tools.cli.newest import keep_newest
from spotter_tools.cli.site_option import SiteFile, read_site

NOBODY_AFTER_S, SENSORS_EVERY_S = 4.0, 1.0


def cpm(
    to: Annotated[str, typer.Option("--to", help="HOST:PORT; each message is a UDP datagram: UPER, no BTP header.")],
    station_id: Annotated[int, typer.Option("--station-id", min=0, max=2**32 - 1, help="stationId of the messages.")],
    host: Annotated[
        str, typer.Option("--host", callback=own_name, help="The roadside host whose tracks are sent.")
    ] = "infra0",
    accept_simulated: Annotated[
        bool, typer.Option("--accept-simulated", help="Send recorded, emulated and simulated tracks too: trials only.")
    ] = False,
    count: Annotated[int, typer.Option("--count", "-n", min=0, help="Stop after this many messages; 0 = never.")] = 0,
    site_file: SiteFile = None,
    connect: Connect = DEFAULT_ENDPOINT,
    namespace: Namespace = "",
) -> None:
    """Send what a roadside host tracks as Collective Perception Messages (TS 103 324 V2.1.1) until Ctrl-C.

    The site's [map] says where the map lies. Tracks that are not live, or of a sensor that is degraded, are not sent.
    """
    try:
        from spotter_tools.cpm.codec import CpmError, encode
        from spotter_tools.cpm.message import messages_of
    except ImportError:
        needs_extra("Collective Perception Messages need", "cpm")
    origin = read_site(site_file)[0].map
    if origin is None:
        fail(f"cpm: {NO_ORIGIN} (--site FILE)", code=2)
    address = _address(to)
    arrived: queue.Queue[zenoh.Sample] = queue.Queue(2)
    key, sent, sensors_due_s = INFRA_TRACKS.key(host), 0, 0.0
    reported: str | None = None
    with bus(connect, namespace) as session, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as radio:
        session.declare_subscriber(key, lambda sample: keep_newest(arrived, sample))
        while not count or sent < count:
            try:
                message = decode(arrived.get(timeout=NOBODY_AFTER_S).payload.to_bytes(), ObjectTracks)
                reason = why_not(message, accept_simulated)
                if not reason:
                    with_sensors = time.monotonic() >= sensors_due_s
                    for content in messages_of(message, origin, station_id, with_sensors):
                        radio.sendto(encode(content), address)
                        sent += 1
                    sensors_due_s = time.monotonic() + SENSORS_EVERY_S if with_sensors else sensors_due_s
            except queue.Empty:
                reason = _why_nothing(session, key, reported=reported is not None)
            except (DecodeError, CpmError) as error:
                reason = f"{key}: {error}"
            except OSError as error:  # the roadside unit or the network may be away for a while
                reason = f"--to {to}: {error.strerror or error}"
            if reason != reported:
                sys.stderr.write(f"spotter: {f'not sent: {reason}' if reason else f'sending to {to}'}\n")
                reported = reason


def _why_nothing(session: zenoh.Session, key: str, *, reported: bool) -> str:
    """Ends the command when no service publishes; not once tracks have come, because their service may start again."""
    silent = why_silent(session, key)
    if silent and not reported:
        fail(silent)
    return silent or f"nothing comes on {key}"


def why_not(message: ObjectTracks, accept_simulated: bool) -> str:
    """Why these tracks must not be sent to others; "" = they may."""
    if message.source_kind != "live" and not accept_simulated:
        return f"the tracks are {message.source_kind}, not live (--accept-simulated for trials)"
    if message.state != "online":
        return f"the sensor is {message.state}: {message.reason}"
    if message.frame_id not in ("", MAP_FRAME):
        return f"the tracks are in the frame {message.frame_id}, not {MAP_FRAME}"
    return ""


def _address(to: str) -> tuple[str, int]:
    host, colon, port = to.rpartition(":")
    if not colon or not host or not port.isdecimal() or not 0 < int(port) < 65536:
        fail(f"--to {to}: expected HOST:PORT", code=2)
    return host, int(port)
