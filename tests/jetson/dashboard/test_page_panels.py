"""What a panel says is of what it shows, in a real browser: one message drawn once, one age, one vehicle."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import numpy as np
import pytest

from common import topics
from common.bus.runtime import Service
from common.config import ServiceConfig, ZenohConfig
from common.messages import CameraDetection, CameraDetections, Message, RadarTracks, SensorHealth, SystemHealth
from services.jetson.camera.annotate import picture
from services.jetson.camera.config import ImageConfig, ZoneConfig

pytestmark = [pytest.mark.system, pytest.mark.slow]
WORDS = "document.getElementById('{}').textContent"


def keep_texts(browser: Any, element: str) -> None:
    """From now on ``window.kept`` has the text of this element and every later one."""
    browser.run(f"""
        window.kept = [{WORDS.format(element)}];
        new MutationObserver(() => window.kept.push({WORDS.format(element)}))
          .observe(document.getElementById('{element}'), {{childList: true, characterData: true, subtree: true}}); 0
    """)


@pytest.fixture(scope="module")
def dashboard(module_router: str, start_dashboard_at: Callable[..., Any]) -> Any:
    return start_dashboard_at(module_router, 'other_hosts=["pi1"]')


@contextmanager
def speaking(endpoint: str, *says: tuple[topics.Topic, str, Callable[[], Message]]) -> Iterator[None]:
    """A service for each topic, on the host that is named, at 10 Hz."""
    stop = threading.Event()

    def live() -> None:
        with ExitStack() as stack:
            services: dict[str, Service] = {}
            publishers = []
            for topic, host, make in says:
                name = f"{host}/{topic.service}"
                if name not in services:
                    config = ServiceConfig(host=host, zenoh=ZenohConfig(connect=(endpoint,)))
                    services[name] = stack.enter_context(Service(topic.service, config))
                publishers.append((services[name].publisher(topic), make))
            while not stop.wait(0.1):
                for publish, make in publishers:
                    publish(make())

    thread = threading.Thread(target=live)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def radar(floor_db: float) -> Callable[[], RadarTracks]:
    def make() -> RadarTracks:
        return RadarTracks(stamp_ns=time.time_ns(), tracks=[], level="SAFE", settled=True, noise_floor_db=floor_db)

    return make


def test_a_panel_that_comes_back_into_sight_is_not_called_stale(
    browser: Any, dashboard: Any, module_router: str
) -> None:
    with speaking(module_router, (topics.RADAR_TRACKS, "pi0", radar(-60.0))):
        browser.open(dashboard.url, 360, 500)
        go = "document.getElementById('{}').scrollIntoView()"
        browser.run(go.format("t-radar"))
        browser.wait(f"{WORDS.format('radar-words')}.includes('noise floor -60 dB')")
        keep_texts(browser, "radar-words")
        browser.run(go.format("t-clocks"))
        out_of_sight_since_s, pause = time.monotonic(), threading.Event()
        while time.monotonic() - out_of_sight_since_s < 1.5:  # three times what is called stale
            pause.wait(0.1)
        browser.run(go.format("t-radar"))
        back_since_s = time.monotonic()
        while time.monotonic() - back_since_s < 1.0:
            pause.wait(0.1)
        assert not [text for text in browser.run("window.kept") if "stale" in text]
        assert "noise floor -60 dB" in browser.run(WORDS.format("radar-words"))


def test_what_is_still_silent_is_called_stale_with_its_age(browser: Any, dashboard: Any, module_router: str) -> None:
    browser.open(dashboard.url, 1400, 1000)
    with speaking(module_router, (topics.RADAR_TRACKS, "pi0", radar(-60.0))):
        browser.wait(f"{WORDS.format('radar-words')}.includes('noise floor -60 dB')")
    browser.wait(f"/stale: [0-9.]+ m?s old/.test({WORDS.format('radar-words')})")
    browser.wait(f"/radar stale: [0-9.]+ m?s old/.test({WORDS.format('ahead-words')})")
    assert browser.run("document.getElementById('ttc').classList.contains('stale')")


def test_another_vehicle_s_sensor_is_not_shown(browser: Any, dashboard: Any, module_router: str) -> None:
    own, other = (topics.RADAR_TRACKS, "pi0", radar(-60.0)), (topics.RADAR_TRACKS, "pi1", radar(-20.0))
    with speaking(module_router, own, other):
        browser.open(dashboard.url, 1400, 1000)
        keep_texts(browser, "radar-words")
        browser.wait("window.kept.some((text) => text.includes('-60 dB'))")
        seen = browser.run(
            "fetch('/api/snapshot').then((reply) => reply.json()).then((all) => Object.keys(all.entries))"
        )
        assert "pi0/radar/tracks" in seen
        assert not [key for key in seen if key.startswith("pi1/")]
        assert not [text for text in browser.run("window.kept") if "-20 dB" in text]


def test_the_name_of_the_vehicle_stands_before_the_health_bar(browser: Any, dashboard: Any, module_router: str) -> None:
    def health() -> SystemHealth:
        return SystemHealth(
            stamp_ns=time.time_ns(), sensors={}, colour="green", summary="ALL WELL", services={}, vehicle="car1"
        )

    with speaking(module_router, (topics.FUSION_HEALTH, "jetson0", health)):
        browser.open(dashboard.url, 1400, 1000)
        browser.wait(f"{WORDS.format('health')} == 'car1: ALL WELL'")


def test_a_sensor_that_nobody_has_takes_no_room(browser: Any, dashboard: Any, module_router: str) -> None:
    hidden = "document.querySelector('[data-sensor={}]').hidden"

    def health() -> SystemHealth:
        radar = SensorHealth(state="online", reason="", since_ns=1, age_ms=50.0, rate_hz=10.0)
        return SystemHealth(
            stamp_ns=time.time_ns(), sensors={"radar": radar}, colour="green", summary="ALL WELL", services={}
        )

    with speaking(module_router, (topics.FUSION_HEALTH, "jetson0", health)):
        browser.open(dashboard.url, 1400, 1000)
        browser.wait(f"{hidden.format('infra_lidar')} && {hidden.format('camera')} && !{hidden.format('radar')}")
        seen = (topics.CAMERA_DETECTIONS, "jetson0", lambda: seen_at(time.time_ns(), "person", 7.0, 6.5))
        with speaking(module_router, seen):
            browser.wait(f"!{hidden.format('camera')}")
            assert browser.run(hidden.format("infra_lidar"))


def seen_at(stamp_ns: int, label: str, distance_m: float, nearest_m: float) -> CameraDetections:
    found = CameraDetection(
        label=label, confidence=0.9, box_xyxy_px=(2.0, 2.0, 60.0, 60.0), distance_m=distance_m, level="IMMINENT",
        in_zone=True, truncated=True, nearest_m=nearest_m,
    )  # fmt: skip
    return CameraDetections(
        stamp_ns=stamp_ns, detections=[found], brightness=99.0, level="IMMINENT", image_size_px=(64, 64)
    )


def test_the_words_below_the_picture_are_those_in_it(browser: Any, dashboard: Any, module_router: str) -> None:
    """Whenever one looks: the grey of each picture is that of its distance, and detections come more often."""

    def image() -> Message:
        tenths = int(time.monotonic() * 10) % 10  # another one every time
        seen = seen_at(time.time_ns(), "car", 30.0, float(tenths))
        return picture(np.full((64, 64, 3), 20 * tenths, np.uint8), seen, ZoneConfig(), ImageConfig())

    def detections() -> Message:
        return seen_at(time.time_ns(), "person", 7.0, 6.5)

    with speaking(
        module_router, (topics.CAMERA_DETECTIONS, "jetson0", detections), (topics.CAMERA_IMAGE, "jetson0", image)
    ):
        browser.open(dashboard.url, 1400, 1000)
        browser.wait(f"{WORDS.format('camera-words')}.startsWith('car')")
        looks = browser.run("""(async () => {
            const pen = new OffscreenCanvas(64, 64).getContext("2d"), looks = [];
            for (let turn = 0; turn < 100; turn += 1) {
              await new Promise(requestAnimationFrame);
              pen.drawImage(document.getElementById("camera"), 0, 0);
              looks.push([document.getElementById("camera-words").textContent, pen.getImageData(40, 40, 1, 1).data[0]]);
            }
            return looks;
        })()""")
    assert len({words for words, _ in looks}) > 3
    for words, grey in looks:
        assert words == f"car <= {round(grey / 20)}.0 m"
