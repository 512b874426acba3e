"""One look at a small real system: as text, as JSON, on the screen."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable
from types import ModuleType

import msgspec
import pytest
from typer.testing import CliRunner

from common.bus.runtime import Service
from common.bus.status import Report
from common.codec import encode
from common.config import ServiceConfig, ZenohConfig
from common.messages import ClockHealth
from spotter_tools.cli.__main__ import app
from spotter_tools.cli.connect import bus
from spotter_tools.cli.fusion_view import FusionWatch, quantile
from spotter_tools.cli.system_view import Observer, Overview, ServiceView
from spotter_tools.cli.top import bar_lines

pytestmark = pytest.mark.patient

Until = Callable[[Callable[[], object]], None]
runner = CliRunner()


def service_of(overview: Overview, name: str) -> object:
    return next((one for one in overview.services if one.service == name), None)


def test_an_overview_holds_what_is_there(speaking: str, until: Until) -> None:
    with bus(speaking, "spotter") as session:
        observer = Observer(session)
        until(lambda: observer.complete() and len(observer.overview().services) == 3)
        until(lambda: all(one.cpu_share is not None for one in observer.overview().services))
        until(lambda: observer.overview().fusions[0].sensors["lidar"].latency_p99_ms is not None)
        overview = observer.overview()
        observer.close()
    (fusion,) = overview.fusions
    assert fusion.verdict is not None
    assert (fusion.host, fusion.vehicle, fusion.verdict.level) == ("jetson0", "", "CAUTION")
    assert (fusion.sensors["lidar"].latency_p50_ms or 0) >= 20  # the verdict is of a measurement 20 ms before
    assert [(one.host, one.service, one.instances, one.state) for one in overview.services] == [
        ("jetson0", "fusion", 1, "online"), ("jetson0", "lidar", 1, "online"), ("pi0", "radar", 1, "online"),
    ]  # fmt: skip
    verdicts = next(one for one in overview.topics if one.key == "jetson0/fusion/verdict")
    assert verdicts.rate_hz > 5
    assert verdicts.bytes_per_s > 1000
    assert not verdicts.stale


def test_a_laptop_s_recorder_is_there_while_it_tells(speaking: str, until: Until) -> None:
    """Where rules are in force it has no token."""

    def state(observer: Observer) -> object:
        return getattr(service_of(observer.overview(), "recorder"), "state", None)

    with bus(speaking, "spotter") as session, bus(speaking, "spotter") as laptop:
        observer = Observer(session)
        word = encode(Report("x").snapshot())
        until(lambda: laptop.put("laptop1/recorder/status", word) or state(observer) == "starting")
        until(lambda: state(observer) == "disconnected")
        observer.close()


def test_one_host_can_be_looked_at_alone(speaking: str, until: Until) -> None:
    with bus(speaking, "spotter") as session:
        observer = Observer(session, "pi0")
        until(lambda: observer.complete() and len(observer.overview().topics) >= 2)
        overview = observer.overview()
        observer.close()
    assert {one.host for one in overview.services} == {"pi0"}
    assert {one.key.split("/")[0] for one in overview.topics} == {"pi0"}
    assert [(fusion.host, fusion.verdict) for fusion in overview.fusions] == [("", None)]


def test_a_service_that_went_away_is_said_to_be_gone(zenoh_config: ZenohConfig, until: Until) -> None:
    with bus(zenoh_config.connect[0], "spotter") as session:
        observer = Observer(session)
        with Service("radar", ServiceConfig(host="pi0", zenoh=zenoh_config)):
            until(lambda: observer.overview().services and observer.overview().services[0].rss_mb > 0)
        until(lambda: observer.overview().services[0].instances == 0)
        (radar,) = observer.overview().services
        observer.close()
    assert (radar.state, radar.reason) == ("disconnected", "the process is gone")


def test_a_service_that_hangs_is_not_shown_as_it_last_was(
    zenoh_config: ZenohConfig, until: Until, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its token stays up, as that of a process whose interpreter stands still."""
    monkeypatch.setattr("spotter_tools.cli.system_view.STATUS_AGE_LIMIT_S", 0.3)
    with bus(zenoh_config.connect[0], "spotter") as session, bus(zenoh_config.connect[0], "spotter") as other:
        observer = Observer(session)
        token = other.liveliness().declare_token("pi0/radar/alive/a")
        report = Report("a")
        report.state("online")
        word = encode(report.snapshot())
        until(lambda: other.put("pi0/radar/status", word) or getattr(radar_of(observer), "state", "") == "online")
        until(lambda: getattr(radar_of(observer), "state", "") == "disconnected")
        radar = radar_of(observer)
        token.undeclare()
        observer.close()
    assert radar.instances == 1
    assert radar.reason == "does not answer: no status for 0 s, its process is there"


def radar_of(observer: Observer) -> ServiceView:
    return service_of(observer.overview(), "radar")  # type: ignore[return-value]


def test_once_prints_everything_as_text_and_as_json(speaking: str) -> None:
    text = runner.invoke(app, ["top", "--once", "--connect", speaking])
    assert text.exit_code == 0, text.output
    for words in ("CAUTION -> SLOW", "GREEN: bar", "pi0/radar", "jetson0/fusion/verdict", "MB"):
        assert words in text.output
    line = runner.invoke(app, ["top", "--once", "--json", "--connect", speaking])
    seen = json.loads(line.stdout)
    assert seen["fusions"][0]["verdict"]["rule"] == "R-CAUTION"
    assert {one["service"] for one in seen["services"]} == {"fusion", "lidar", "radar"}
    assert msgspec.convert(seen, Overview, strict=False).fusions[0].colour == "green"


def test_silence_is_no_verdict(zenoh_config: ZenohConfig) -> None:
    result = runner.invoke(app, ["top", "--once", "--connect", zenoh_config.connect[0]])
    assert "NO VERDICT" in result.output
    assert "treat as STOP" in result.output


def test_the_screen_shows_it_and_q_quits(speaking: str, until: Until) -> None:
    top_app = pytest.importorskip("spotter_tools.cli.top_app")
    from textual.widgets import DataTable, Static

    with bus(speaking, "spotter") as session:
        observer = Observer(session)
        until(lambda: observer.complete() and len(observer.overview().services) == 3)
        screen = top_app.TopApp(observer, 0.1)

        async def use() -> None:
            async with screen.run_test(size=(160, 50)) as pilot:
                await pilot.pause()
                services = screen.query_one("#services", DataTable)
                assert [services.get_cell_at((row, 0)) for row in range(3)] == [
                    "jetson0/fusion", "jetson0/lidar", "pi0/radar",
                ]  # fmt: skip
                assert "CAUTION" in str(screen.query_one("#verdict", Static).render())
                assert screen.query_one("#verdict", Static).has_class("CAUTION")
                await pilot.press("p")
                assert screen.sub_title == "paused"
                await pilot.press("q")
            assert not screen.is_running

        asyncio.run(use())
        observer.close()


BEHIND_MS = -56 * 365.25 * 86400e3


@pytest.mark.parametrize(
    ("offset_ms", "measured", "latency_ms"),
    [(0.0, False, 30.0), (-400.0, True, 30.0), (BEHIND_MS, True, 30.0), (BEHIND_MS, False, None)],
    ids=["right", "a little behind", "1970", "1970, not measured yet"],
)
def test_a_sensor_s_wrong_clock_is_no_latency(
    speakers: ModuleType, offset_ms: float, measured: bool, latency_ms: float | None
) -> None:
    watch, now_ns = FusionWatch(0.0), time.time_ns()
    health, verdict = speakers.health(now_ns), speakers.verdict(now_ns)
    if measured:
        health.clocks["jetson0/lidar"] = ClockHealth(offset_ms=offset_ms, bound_ms=1.0, age_s=0.0, trusted=True)
    verdict.inputs["lidar"].stamp_ns = now_ns + int(offset_ms * 1e6)
    verdict.sent_ns = now_ns + 30_000_000
    watch.note_health(health, 1.0)
    watch.note_verdict(verdict, 1.0)
    shown = watch.view("jetson0", "", 1.0).sensors["lidar"].latency_p50_ms
    assert shown == (None if latency_ms is None else pytest.approx(latency_ms, abs=0.01))


def test_the_health_of_a_fusion_that_is_silent_is_not_shown_as_it_was(speakers: ModuleType) -> None:
    watch = FusionWatch(0.0)
    watch.note_health(speakers.health(time.time_ns()), 1.0)
    assert (watch.view("jetson0", "", 2.9).colour, set(watch.view("jetson0", "", 2.9).sensors)) == ("green", {"lidar"})
    late = watch.view("jetson0", "", 3.1)
    assert (late.colour, late.sensors) == ("", {})
    assert bar_lines(Overview(fusions=[late], services=[], topics=[])) == ["health unknown: fusion does not publish"]


def test_quantiles_are_ranks() -> None:
    values = [float(i) for i in range(1, 101)]
    assert (quantile(values, 0.5), quantile(values, 0.99), quantile([3.0], 0.99), quantile([], 0.5)) == (
        50,
        99,
        3,
        None,
    )
