"""Spotter from a notebook: the newest value, a stream, a question. Typed messages, nothing to configure.

::

    from spotter_client import RadarTracks, connect

    with connect("tcp/127.0.0.1:7447") as bus:
        print(bus.latest("jetson0/fusion/verdict").level)

        for tracks in bus.stream("pi0/radar/tracks", RadarTracks, seconds=10):
            print([(track.range_m, track.ttc_s) for track in tracks.tracks])

        for service in bus.services():
            print(service.host, service.name, service.state, service.reason)

        speeds = bus.stream("pi0/radar/tracks", seconds=10).to_pandas(each="tracks")  # or to_polars

    alarms = open_recording("recordings").stream("*/fusion/verdict").to_pandas()

In notebook cells: ``bus = connect(...)`` in one, ``bus.close()`` in the last. It works beside a package of your own
that is named ``common``.

Keys are ``<host>/<service>/<product>``; the README's table lists them with their messages. The examples in
``examples/`` are run by the tests.
"""

from __future__ import annotations

from pathlib import Path

from spotter_client.own_common import own_common

with own_common():
    from common.bus.namespace import settled
    from common.bus.session import init_zenoh_log, open_session
    from common.codec import prepare
    from common.config import ConfigError, ZenohConfig
    from common.messages import (
        CameraDetections,
        Clusters,
        CompressedImage,
        EgoMotion,
        LaserScan,
        LidarZones,
        Message,
        ObjectTracks,
        PointCloud,
        RadarDetections,
        RadarTracks,
        ServiceInfo,
        ServiceStatus,
        SystemHealth,
        Verdict,
    )
    from common.security.router_config import with_certificate
    from common.topics import DATA_TOPICS, RAW_TOPICS
    from spotter_client.bus import Bus, Received, ServiceOnBus
    from spotter_client.recording import Recording, open_recording
    from spotter_client.stream import Stream

    # msgspec looks up what a type is made of when its first decoder is made, by the names of our modules.
    prepare({topic.message for topic in (*DATA_TOPICS, *RAW_TOPICS)} | {ServiceInfo, ServiceStatus})

__all__ = [
    "Bus",
    "CameraDetections",
    "Clusters",
    "CompressedImage",
    "ConfigError",
    "EgoMotion",
    "LaserScan",
    "LidarZones",
    "Message",
    "ObjectTracks",
    "PointCloud",
    "RadarDetections",
    "RadarTracks",
    "Received",
    "Recording",
    "ServiceInfo",
    "ServiceOnBus",
    "ServiceStatus",
    "Stream",
    "SystemHealth",
    "Verdict",
    "connect",
    "open_recording",
]


def connect(
    *endpoints: str,
    namespace: str = "",
    certificate: str | Path | None = None,
    give_up_after_s: float = 3.0,
) -> Bus:
    """A client of a router: ``bus = connect("tcp/192.168.1.20:7447")``, and ``bus.close()`` when done; or ``with
    connect(...) as bus``. Without an endpoint: this machine's.

    ``certificate`` is for a site with TLS: ``"keys/laptop1.crt"``, its key and ``ca.crt`` beside it.

    Without a ``namespace``: ``spotter``, or ``demo`` where only a demo runs.

    Raises:
        ConnectionError: no router answers.
        ConfigError: an endpoint that Zenoh refuses, or a certificate that is not there.
    """
    init_zenoh_log(None)
    config = ZenohConfig(connect=endpoints or ("tcp/127.0.0.1:7447",), namespace=namespace)
    if certificate is not None:
        config = with_certificate(config, Path(certificate).parent, Path(certificate).stem)
    return Bus(open_session(settled(config, give_up_after_s), give_up_after_s=give_up_after_s))
