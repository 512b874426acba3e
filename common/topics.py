"""THE table: every topic, who owns it, what it carries, how often, and how old it may get.

Publishers, subscribers, health, the recorder, the access rules, the tests and the README's table all come from here.
Keys are ``<host>/<service>/<product>`` under the session's namespace, so no code spells the site.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from common import messages as m

Priority = Literal["real_time", "interactive_high", "data_high", "data", "data_low", "background"]
Congestion = Literal["drop", "block_first"]
Role = Literal["onboard", "roadside"]


@dataclass(frozen=True)
class Topic:
    """One row of the table.

    ``age_limit_s`` is the age at which a reader has to call the data stale (None: no decision depends on it).
    ``on_demand`` topics are published only while there is a subscriber.
    ``role`` marks the one topic of each sensor that fusion decides on, and where the sensor is: on the vehicle or
    beside the road. Such a topic needs an age limit.
    """

    service: str
    product: str
    message: type[m.Message]
    nominal_hz: float | None
    age_limit_s: float | None = None
    on_demand: bool = False
    priority: Priority = "data"
    congestion: Congestion = "drop"
    max_bytes: int = 1_000_000
    role: Role | None = None

    @property
    def is_large(self) -> bool:
        """Clouds and pictures: behind everything else, and each kind in a queue of its own."""
        return self.priority in ("data_low", "background")

    @property
    def name(self) -> str:
        """``<service>/<product>``."""
        return f"{self.service}/{self.product}"

    def key(self, host: str) -> str:
        """The key on one host: ``<host>/<service>/<product>``."""
        return f"{host}/{self.service}/{self.product}"

    @property
    def any_host(self) -> str:
        """The key expression for this topic on every host."""
        return f"*/{self.service}/{self.product}"


@dataclass(frozen=True)
class ServiceRow:
    """One service: its name everywhere, the host role that runs it by default and the extra it needs."""

    name: str
    host: str
    extra: str

    @property
    def script(self) -> str:
        """The console command of the service."""
        return "spotter-" + self.name.replace("_", "-")


SERVICES: tuple[ServiceRow, ...] = (
    ServiceRow("radar", "pi0", "radar-pi"),
    ServiceRow("lidar", "jetson0", "jetson"),
    ServiceRow("camera", "jetson0", "jetson"),
    ServiceRow("fusion", "jetson0", "jetson"),
    ServiceRow("dashboard", "jetson0", "jetson"),
    ServiceRow("infra_lidar", "infra0", "infra-lidar"),
)

# Optional: no other service depends on them.
OPTIONAL_SERVICES: tuple[ServiceRow, ...] = (
    ServiceRow("ego", "jetson0", "jetson"),
    ServiceRow("gate", "jetson0", "jetson"),
)

# On as many hosts as site.toml says.
SERVICES_OF_ANY_HOST: tuple[ServiceRow, ...] = (ServiceRow("blackbox", "jetson0", "record"),)

# Of no site: `spotter record` says under this name that it runs, on a host or, with its status alone, on a laptop.
RECORDER = "recorder"

RADAR_TRACKS = Topic("radar", "tracks", m.RadarTracks, 10.0, 0.5, priority="data_high", role="onboard")
RADAR_DETECTIONS = Topic("radar", "detections", m.RadarDetections, 10.0, on_demand=True)
RADAR_MOTION = Topic("radar", "motion", m.EgoMotion, 10.0, priority="data_high")  # the own speed from standing echoes
LIDAR_SCAN = Topic("lidar", "scan", m.LaserScan, 10.0)
LIDAR_ZONES = Topic("lidar", "zones", m.LidarZones, 10.0, 0.5, priority="data_high", role="onboard")
CAMERA_DETECTIONS = Topic(
    "camera", "detections", m.CameraDetections, 15.0, 1.0,
    priority="data_high", role="onboard",
)  # fmt: skip
CAMERA_IMAGE = Topic(
    "camera", "image", m.CompressedImage, 5.0, on_demand=True,
    priority="data_low", congestion="block_first", max_bytes=8_000_000,
)  # fmt: skip
INFRA_TRACKS = Topic("infra_lidar", "tracks", m.ObjectTracks, 10.0, 0.5, priority="data_high", role="roadside")
INFRA_CLUSTERS = Topic("infra_lidar", "clusters", m.Clusters, 10.0, on_demand=True)
INFRA_POINTS = Topic(
    "infra_lidar", "points", m.PointCloud, 5.0, on_demand=True,
    priority="background", congestion="block_first", max_bytes=16_000_000,
)  # fmt: skip
FUSION_VERDICT = Topic("fusion", "verdict", m.Verdict, 20.0, 0.25, priority="interactive_high")
FUSION_HEALTH = Topic("fusion", "health", m.SystemHealth, 2.0, 2.0, priority="interactive_high")
FUSION_TRACE = Topic("fusion", "trace", m.FusionTrace, 20.0, on_demand=True)
EGO_MOTION = Topic("ego", "motion", m.EgoMotion, 20.0, 0.5, priority="data_high")
GATE_STATE = Topic("gate", "state", m.GateState, 10.0, 0.5, priority="interactive_high")

DATA_TOPICS: tuple[Topic, ...] = (
    LIDAR_SCAN,
    LIDAR_ZONES,
    RADAR_TRACKS,
    RADAR_DETECTIONS,
    RADAR_MOTION,
    CAMERA_DETECTIONS,
    CAMERA_IMAGE,
    INFRA_TRACKS,
    INFRA_CLUSTERS,
    INFRA_POINTS,
    FUSION_VERDICT,
    FUSION_HEALTH,
    FUSION_TRACE,
    EGO_MOTION,
    GATE_STATE,
)

# What fusion decides on, by sensor, in the order in which the health bar names them.
SENSOR_TOPICS: dict[str, Topic] = {topic.service: topic for topic in DATA_TOPICS if topic.role is not None}
ONBOARD_SENSORS: tuple[str, ...] = tuple(name for name, topic in SENSOR_TOPICS.items() if topic.role == "onboard")

# How people read a sensor's name, where that differs from its name on the bus.
_SPOKEN_NAMES = {"lidar": "LiDAR", "infra_lidar": "roadside LiDAR"}


def spoken(sensor: str) -> str:
    """A sensor's name in every text for people: LiDAR, radar, camera, roadside LiDAR."""
    return _SPOKEN_NAMES.get(sensor, sensor.replace("_", " "))


# Bytes as a device sent them, for recordings that are to be processed again; only while there is a subscriber.
# The small streams have a queue of their own: a picture that is late must not cost a byte of the lidar. They come in
# bursts, of which block_first would take the first only.
def _raw(service: str, priority: Priority, congestion: Congestion) -> Topic:
    return Topic(
        service, "raw", m.RawBytes, None, on_demand=True,
        priority=priority, congestion=congestion, max_bytes=32_000_000,
    )  # fmt: skip


RADAR_RAW, LIDAR_RAW = _raw("radar", "data", "drop"), _raw("lidar", "data", "drop")
CAMERA_RAW, INFRA_RAW = _raw("camera", "data_low", "block_first"), _raw("infra_lidar", "background", "block_first")
RAW_TOPICS = (RADAR_RAW, LIDAR_RAW, CAMERA_RAW, INFRA_RAW)


@dataclass(frozen=True)
class Command:
    """A question that makes a service do something: asked at ``<host>/<service>/<name>``, answered, never published.

    ``from_afar``: laptops and other hosts may ask it too, otherwise only this host's own sessions.
    """

    service: str
    name: str
    from_afar: bool


COMMANDS: tuple[Command, ...] = (
    Command("fusion", "acknowledge", from_afar=False),  # ends alarms: only for a person at the vehicle
    Command("infra_lidar", "recalibrate", from_afar=False),  # the sensor sees nothing until it has found the road
    Command("gate", "acknowledge", from_afar=False),  # a person beside the vehicle says that it may move again
    Command("blackbox", "incidents", from_afar=True),
    Command("blackbox", "capsule", from_afar=True),
    Command("blackbox", "save", from_afar=True),  # bounded: one open incident at a time, the oldest goes
)

# How old a camera picture may be to confirm or to suppress another sensor's alert (bench-stack A20).
CAMERA_CONFIRM_AGE_S = 0.5


def status_topic(service: str) -> Topic:
    """``<host>/<service>/status``: on change and 1 Hz, and a queryable on the same key."""
    return Topic(service, "status", m.ServiceStatus, 1.0, 3.0, priority="interactive_high")


def info_key(host: str, service: str) -> str:
    """Queried for what a service runs: version, configuration, source."""
    return f"{host}/{service}/info"


def clock_key(host: str, service: str) -> str:
    """Queried to measure how far a service's clock is off."""
    return f"{host}/{service}/clock"


def links_key(host: str) -> str:
    """Asked of this host's own router (``RouterLinks``); no other host may ask it."""
    return f"{host}/router/links"


def token_key(host: str, service: str, instance: str) -> str:
    """The liveliness token: up while the process lives; a fresh instance id per start."""
    return f"{host}/{service}/alive/{instance}"


ANY_TOKEN = "*/*/alive/*"


def parse_token(key: str) -> tuple[str, str, str]:
    """Token key to (host, service, instance).

    Raises:
        ValueError: not a token key.
    """
    parts = key.split("/")
    if len(parts) != 4 or parts[2] != "alive":
        raise ValueError(f"not a liveliness token of ours: {key!r}")
    return parts[0], parts[1], parts[3]


def find_topic(key: str) -> Topic | None:
    """The row of the table that a concrete key ``<host>/<service>/<product>`` belongs to, or None."""
    parts = key.split("/")
    if len(parts) != 3 or not all(parts):
        return None
    _, service, product = parts
    if product == "status":
        return status_topic(service)
    return next((t for t in (*DATA_TOPICS, *RAW_TOPICS) if t.service == service and t.product == product), None)


def service_row(name: str) -> ServiceRow:
    """Raises ``KeyError`` with the known names when there is no such service."""
    rows = (*SERVICES, *OPTIONAL_SERVICES, *SERVICES_OF_ANY_HOST)
    for row in rows:
        if row.name == name:
            return row
    raise KeyError(f"no service {name!r}; known: {', '.join(row.name for row in rows)}")
