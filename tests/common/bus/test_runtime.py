"""The shared runtime over real Zenoh: presence, status, queries, newest value, rivals, policy, reconnecting."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from functools import partial

import msgpack
import pytest
import zenoh

from common import topics
from common.bus.presence import Presence
from common.bus.runtime import Service
from common.bus.session import build, close_session, open_session
from common.codec import decode
from common.config import ConfigError, ServiceConfig, ZenohConfig
from common.messages import ClockReply, LidarZone, LidarZones, RadarTracks, ServiceInfo, ServiceStatus

BUDGET_S = 60.0


@pytest.fixture
def until(until: Callable[..., None]) -> Callable[..., None]:
    """Within the budget of this file."""
    return partial(until, budget_s=BUDGET_S)


def radar_tracks(stamp_ns: int = 1, state: str = "online", reason: str = "") -> RadarTracks:
    return RadarTracks(
        stamp_ns=stamp_ns, tracks=[], level="SAFE", settled=True, noise_floor_db=0.0, state=state, reason=reason
    )  # type: ignore[arg-type]


def pi(zenoh_config: ZenohConfig) -> ServiceConfig:
    return ServiceConfig(host="pi0", zenoh=zenoh_config, source="sim:crossing")


def jetson(zenoh_config: ZenohConfig) -> ServiceConfig:
    return ServiceConfig(host="jetson0", zenoh=zenoh_config)


def test_token_status_info_and_clock_answer(zenoh_config: ZenohConfig, until: Callable[..., None]) -> None:
    with Service("radar", pi(zenoh_config)) as radar, open_session(zenoh_config) as laptop:
        radar.publisher(topics.RADAR_TRACKS)
        presence = Presence(laptop)
        until(lambda: presence.instances("pi0", "radar") == {("pi0", "radar", radar.instance)})

        (reply,) = laptop.get(topics.info_key("pi0", "radar"), timeout=5)
        info = decode(reply.ok.payload.to_bytes(), ServiceInfo)
        assert (info.service, info.host, info.instance) == ("radar", "pi0", radar.instance)
        assert info.topics == ["pi0/radar/tracks"]
        assert (info.source, info.source_kind) == ("sim:crossing", "simulated")

        (reply,) = laptop.get(topics.status_topic("radar").key("pi0"), timeout=5)
        status = decode(reply.ok.payload.to_bytes(), ServiceStatus)
        assert (status.state, status.source_kind) == ("starting", "simulated")

        asked_ns = time.time_ns()
        (reply,) = laptop.get(topics.clock_key("pi0", "radar"), payload=asked_ns.to_bytes(8, "little"), timeout=5)
        clock = decode(reply.ok.payload.to_bytes(), ClockReply)
        assert clock.stamp_ns == asked_ns <= clock.request_received_ns <= clock.reply_sent_ns <= time.time_ns()
        presence.close()


@pytest.mark.parametrize(("source", "kind"), [("sim:crossing", "simulated"), ("spi:0.0", "live"), ("", "unknown")])
def test_every_message_carries_the_kind_of_its_services_source(
    zenoh_config: ZenohConfig, until: Callable[..., None], source: str, kind: str
) -> None:
    config = ServiceConfig(host="pi0", zenoh=zenoh_config, source=source)
    with Service("radar", config) as radar, Service("fusion", jetson(zenoh_config)) as fusion:
        publish, inbox = radar.publisher(topics.RADAR_TRACKS), fusion.latest(topics.RADAR_TRACKS, RadarTracks, "pi0")
        kinds: list[str] = []
        until(lambda: publish(radar_tracks()) or kinds.extend(one.message.source_kind for one in inbox.take()) or kinds)
        assert set(kinds) == {kind}


def test_token_goes_when_the_service_ends(zenoh_config: ZenohConfig, until: Callable[..., None]) -> None:
    changes = threading.Event()
    with open_session(zenoh_config) as laptop:
        presence = Presence(laptop, lambda _: changes.set())
        with Service("radar", pi(zenoh_config)):
            until(lambda: presence.instances(service="radar"))
        until(lambda: not presence.instances())
        assert changes.is_set()
        presence.close()


def test_publishing_makes_it_online_and_messages_carry_seq_and_sending_time(
    zenoh_config: ZenohConfig, until: Callable[..., None]
) -> None:
    with Service("radar", pi(zenoh_config)) as radar, Service("fusion", jetson(zenoh_config)) as fusion:
        publish = radar.publisher(topics.RADAR_TRACKS)
        inbox = fusion.latest(topics.RADAR_TRACKS, RadarTracks, "pi0")
        received = []
        for seq in range(3):
            until(lambda: publish.has_subscribers)
            publish(radar_tracks())
            assert fusion.wake.wait(BUDGET_S)
            fusion.wake.clear()
            received += inbox.take()
            assert received[-1].message.seq == seq
            assert received[-1].message.sent_ns <= received[-1].arrived_ns
        assert received[-1].key == "pi0/radar/tracks"
        assert radar.report.snapshot().state == "online"
        assert radar.report.snapshot().published == 3


def test_a_slow_reader_gets_the_newest_and_no_queue(zenoh_config: ZenohConfig, until: Callable[..., None]) -> None:
    with Service("radar", pi(zenoh_config)) as radar, Service("fusion", jetson(zenoh_config)) as fusion:
        publish = radar.publisher(topics.RADAR_TRACKS)
        inbox = fusion.latest(topics.RADAR_TRACKS, RadarTracks, "*")
        until(lambda: publish.has_subscribers)
        for stamp_ns in range(500):
            publish(radar_tracks(stamp_ns))
        newest: list[int] = []

        def drained() -> bool:
            newest.extend(received.message.stamp_ns for received in inbox.take())
            return bool(newest) and newest[-1] == 499

        until(drained)
        assert len(newest) < 500
        assert newest == sorted(newest)


def test_undecodable_input_is_counted_and_the_reader_lives(
    zenoh_config: ZenohConfig, until: Callable[..., None]
) -> None:
    with Service("fusion", jetson(zenoh_config)) as fusion, open_session(zenoh_config) as stranger:
        inbox = fusion.latest(topics.RADAR_TRACKS, RadarTracks, "pi0")
        publisher = stranger.declare_publisher("pi0/radar/tracks")
        until(lambda: publisher.matching_status.matching)
        publisher.put(b"\xc1 nonsense")
        until(fusion.wake.is_set)
        assert inbox.take() == []
        publisher.put(msgpack.packb({"stamp_ns": 1}))
        until(lambda: inbox.take() == [] and fusion.report.snapshot().bad_input == 2)
        assert all("undecodable radar/tracks" in name for name in fusion.report.snapshot().counters)


def test_on_demand_topics_know_whether_anybody_listens(zenoh_config: ZenohConfig, until: Callable[..., None]) -> None:
    with Service("radar", pi(zenoh_config)) as radar, open_session(zenoh_config) as laptop:
        detections = radar.publisher(topics.RADAR_DETECTIONS)
        assert not detections.wanted
        subscriber = laptop.declare_subscriber("pi0/radar/detections", zenoh.handlers.RingChannel(1))
        until(lambda: detections.wanted)
        subscriber.undeclare()
        until(lambda: not detections.wanted)


def test_two_claimants_both_report_and_recover(zenoh_config: ZenohConfig, until: Callable[..., None]) -> None:
    with Service("radar", pi(zenoh_config)) as first:
        first.publisher(topics.RADAR_TRACKS)(radar_tracks())
        with Service("radar", pi(zenoh_config)) as second:
            for one, other in ((first, second), (second, first)):
                until(lambda one=one, other=other: other.instance in one.report.snapshot().reason)  # type: ignore[misc]
            assert first.report.snapshot().state == "degraded"
        until(lambda: first.report.snapshot().state == "online")


def test_nobody_publishes_somebody_elses_topic(zenoh_config: ZenohConfig) -> None:
    with Service("lidar", jetson(zenoh_config)) as lidar:
        with pytest.raises(ValueError, match="lidar may not publish radar/tracks"):
            lidar.publisher(topics.RADAR_TRACKS)
        with pytest.raises(TypeError, match="lidar/zones carries LidarZones, got RadarTracks"):
            lidar.publisher(topics.LIDAR_ZONES)(radar_tracks())


def test_a_degraded_message_degrades_the_service(zenoh_config: ZenohConfig) -> None:
    zone = LidarZone(nearest_m=None, points=0, level="SAFE")
    message = LidarZones(
        stamp_ns=1, left=zone, centre=zone, right=zone, level="SAFE", raw_level="SAFE",
        state="degraded", reason="lens blocked: no return in 15 scans",
    )  # fmt: skip
    with Service("lidar", jetson(zenoh_config)) as lidar:
        lidar.publisher(topics.LIDAR_ZONES)(message)
        status = lidar.report.snapshot()
        assert (status.state, status.reason) == ("degraded", "lens blocked: no return in 15 scans")


def test_services_may_start_before_the_router_and_survive_its_replacement(
    free_ports: Callable[[], int], until: Callable[..., None]
) -> None:
    endpoint = f"tcp/127.0.0.1:{free_ports()}"
    router_config = build(ZenohConfig(mode="router", connect=(), listen=(endpoint,), namespace=""))
    config = ZenohConfig(connect=(endpoint,))
    entered = threading.Event()
    stop = threading.Event()

    def live() -> None:
        with Service("radar", pi(config)) as radar:
            publish = radar.publisher(topics.RADAR_TRACKS)
            entered.set()
            while not stop.wait(0.02):
                publish(radar_tracks())

    early = threading.Thread(target=live)
    early.start()
    assert not entered.wait(0.3), "there is no router yet"
    try:
        for _ in range(2):  # the first router, and the one that replaces it
            with zenoh.open(router_config), open_session(config) as laptop:
                assert entered.wait(BUDGET_S)
                presence = Presence(laptop)
                subscriber = laptop.declare_subscriber("*/radar/tracks", zenoh.handlers.RingChannel(1))
                until(lambda presence=presence: presence.instances("pi0", "radar"))  # type: ignore[misc]
                until(lambda subscriber=subscriber: subscriber.try_recv() is not None)  # type: ignore[misc]
                presence.close()
                subscriber.undeclare()
    finally:
        stop.set()
        early.join(BUDGET_S)
    assert not early.is_alive()


def test_an_absent_router_is_told_within_the_budget(free_ports: Callable[[], int]) -> None:
    config = ZenohConfig(connect=(f"tcp/127.0.0.1:{free_ports()}",))
    with pytest.raises(ConnectionError, match=r"no router answers at tcp/127\.0\.0\.1"):
        open_session(config, give_up_after_s=0.5)


def test_half_a_tls_configuration_is_refused() -> None:
    with pytest.raises(ConfigError, match="set all or none"):
        build(ZenohConfig(certificate="/etc/spotter/pi0.pem"))


def test_a_setting_zenoh_does_not_know_is_named() -> None:
    with pytest.raises(ConfigError, match="transport/warp"):
        build(ZenohConfig(extra={"transport/warp": 9}))


def test_closing_is_quick_and_clean(zenoh_config: ZenohConfig) -> None:
    session = open_session(zenoh_config)
    session.declare_subscriber("**", lambda sample: None)
    assert close_session(session)
