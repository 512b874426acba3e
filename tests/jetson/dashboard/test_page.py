"""The page in a real browser: every state of the bar, stale drawn as stale, a lost server said, usable by anybody.

Set SPOTTER_SCREENSHOTS to a folder to keep a picture of each state.
"""

from __future__ import annotations

import importlib.metadata
import json
import os
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from common import topics
from common.bus.runtime import Service
from common.bus.session import open_session
from common.config import ServiceConfig, ZenohConfig
from common.recording.recorder import RecorderStatus
from common.recording.recorder_status import RecorderPresence
from tests.jetson.dashboard.speaking_fusion import Fusion

pytestmark = [pytest.mark.system, pytest.mark.slow]

AXE = Path(
    str(importlib.metadata.distribution("axe-playwright-python").locate_file("axe_playwright_python/axe.min.js"))
)
BARS = [
    ("green", "ALL VEHICLE SENSORS ONLINE"),
    ("amber", "camera DEGRADED: no visual confirmation"),
    ("red", "LiDAR DISCONNECTED + camera DEGRADED: radar only, static obstacles may be missed"),
    ("red", "ALL VEHICLE SENSORS OUT, SYSTEM BLIND"),
]


@pytest.fixture(scope="module")
def running(module_router: str, start_dashboard_at: Callable[..., Any]) -> Iterator[tuple[Fusion, Any]]:
    """One fusion and one dashboard for the whole file."""
    fusion = Fusion(ZenohConfig(connect=(module_router,)))
    thread = threading.Thread(target=fusion.live)
    thread.start()
    yield fusion, start_dashboard_at(module_router)
    fusion.stop.set()
    thread.join()


@pytest.fixture
def fusion(running: tuple[Fusion, Any]) -> Fusion:
    """The file's fusion, saying SAFE and green again."""
    fusion = running[0]
    fusion.level, fusion.colour, fusion.summary = "SAFE", *BARS[0]
    fusion.blind, fusion.because = False, "LiDAR CAUTION at 0.61 m"
    fusion.sensor_state, fusion.silent, fusion.source_kind = "online", False, "live"
    return fusion


@pytest.fixture
def url(running: tuple[Fusion, Any]) -> str:
    return str(running[1].url)


CUT_OFF = (
    "[...document.querySelectorAll('.scroll, tbody tr')]"
    ".filter((one) => one.scrollWidth > one.clientWidth + 1).map((one) => one.innerText)"
)


def keep_picture(browser: Any, name: str) -> None:
    if folder := os.environ.get("SPOTTER_SCREENSHOTS"):
        Path(folder).mkdir(parents=True, exist_ok=True)
        browser.picture(Path(folder) / f"{name}.png")


def violations(browser: Any) -> list[str]:
    """What axe-core has to say against the page as it is now: contrast, names, roles, structure."""
    browser.run(f"{AXE.read_text()}; 0")
    rules = {"runOnly": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]}
    expression = "r.violations.flatMap((v) => v.nodes.map((n) => `${v.id}: ${n.target} ${n.failureSummary}`))"
    found: list[str] = browser.run(f"axe.run(document, {json.dumps(rules)}).then((r) => {expression})")
    return found


def text_of(element: str) -> str:
    return f"document.getElementById('{element}').textContent"


def test_every_state_of_the_health_bar(browser: Any, fusion: Fusion, url: str) -> None:
    browser.open(url)
    for colour, summary in BARS:
        fusion.colour, fusion.summary = colour, summary
        browser.wait(
            f"{text_of('health')} == '{summary}' && document.getElementById('health').className == 'health {colour}'"
        )
        keep_picture(browser, f"bar-{colour}-{BARS.index((colour, summary))}")


@pytest.mark.parametrize(("level", "permission"), [("SAFE", "GO"), ("CAUTION", "SLOW"), ("IMMINENT", "STOP")])
def test_the_verdict_is_large_and_says_why(browser: Any, fusion: Fusion, url: str, level: str, permission: str) -> None:
    fusion.level = level
    browser.open(url)
    browser.wait(f"{text_of('level')} == '{level}' && {text_of('permission')} == '{permission}'")
    assert browser.run(text_of("because")) == "LiDAR CAUTION at 0.61 m"
    assert "centre lane clear" in browser.run(text_of("to-lower"))
    assert browser.run("parseFloat(getComputedStyle(document.getElementById('level')).fontSize)") > 90
    signs = browser.run("document.querySelector('.sign span').textContent")
    assert signs == {"SAFE": "✓", "CAUTION": "!", "IMMINENT": "✕"}[level]
    assert violations(browser) == []
    keep_picture(browser, f"verdict-{level.lower()}")


@pytest.mark.parametrize("level", ["CAUTION", "IMMINENT"])
def test_a_blind_vehicle_has_a_face_of_its_own_whatever_the_roadside_sees(
    browser: Any, fusion: Fusion, url: str, level: str
) -> None:
    own = "blind: LiDAR disconnected, radar disconnected, camera disconnected"
    fusion.level, fusion.blind, fusion.because = level, True, f"{own}; roadside LiDAR {level} at 9.00 m (car)"
    fusion.colour, fusion.summary = BARS[-1]
    browser.open(url)
    browser.wait(f"{text_of('level')} == 'BLIND'")
    assert browser.run("document.getElementById('verdict').className") == "verdict BLIND"
    assert browser.run(text_of("because")).startswith(own)
    assert browser.run(text_of("rule")) == f"{level}, rule R1-worst-case"
    browser.run("document.getElementById('t-services').scrollIntoView()")
    browser.wait(f"{text_of('slim')}.includes('BLIND')")
    assert browser.run("document.getElementById('slim').className") == "slim BLIND"
    browser.run("window.scrollTo(0, 0)")
    assert violations(browser) == []
    keep_picture(browser, f"blind-{level}")


def test_sensors_have_the_names_that_every_other_text_uses(browser: Any, fusion: Fusion, url: str) -> None:
    browser.open(url)
    browser.wait("document.querySelectorAll('#sensors tr').length > 0")
    for sensor in topics.SENSOR_TOPICS:
        said = f"import('/static/words.js').then((words) => words.spoken('{sensor}'))"
        assert browser.run(said) == topics.spoken(sensor)


def test_a_silent_fusion_is_no_verdict_within_half_a_second(browser: Any, fusion: Fusion, url: str) -> None:
    browser.open(url)
    browser.wait(f"{text_of('level')} == 'SAFE'")
    fusion.silent = True
    browser.wait(f"{text_of('level')} == 'NO VERDICT' && {text_of('permission')} == 'STOP'")
    assert "treat as STOP" in browser.run(text_of("because"))
    keep_picture(browser, "no-verdict")
    browser.wait(f"{text_of('health')}.startsWith('HEALTH UNKNOWN')")
    browser.wait(f"{text_of('sensors')}.includes('unknown, was online')")  # what fusion said of them is old, too
    assert "trusted" not in browser.run(text_of("clocks"))
    assert not browser.run("document.querySelectorAll('#sensors .online, #clocks .online').length")
    keep_picture(browser, "health-unknown")
    fusion.silent = False
    browser.wait(f"{text_of('level')} == 'SAFE' && {text_of('clocks')}.includes('trusted')")
    assert "unknown, was" not in browser.run(text_of("sensors"))


@pytest.mark.parametrize("ahead_min", [10, -10])
def test_the_strip_of_verdicts_does_not_need_the_viewer_s_clock(
    browser: Any, fusion: Fusion, url: str, ahead_min: int
) -> None:
    browser.open(url)
    browser.run(f"(() => {{ const now = Date.now; Date.now = () => now() + {60_000 * ahead_min}; }})()")
    browser.wait(f"{text_of('level')} == 'SAFE'")
    fusion.level = "IMMINENT"
    browser.wait(f"{text_of('level')} == 'IMMINENT'")
    newest = "import('/static/store.js').then((s) => (s.utcMs() - s.state.verdicts.at(-1).stamp_ns / 1e6) / 1000)"
    assert -1.0 < browser.run(newest) < 30.0
    column = "(() => { const c = document.getElementById('timeline'); const d = c.getContext('2d')"
    pixels = ".getImageData(c.width - 2, 0, 1, c.height).data; return [...d].some((v) => v > 0); })()"
    browser.wait(column + pixels)


def test_a_lost_server_greys_the_page_and_comes_back(
    browser: Any, fusion: Fusion, module_router: str, start_dashboard_at: Callable[..., Any]
) -> None:
    dashboard = start_dashboard_at(module_router)
    browser.open(dashboard.url)
    browser.wait(f"{text_of('level')} == 'SAFE'")
    dashboard.close()
    browser.wait("document.body.classList.contains('cut') && !document.getElementById('link').hidden")
    assert browser.run(text_of("level")) == "NO VERDICT"
    browser.wait(f"{text_of('recording')}.includes('Nobody knows')")  # neither recorded nor not recorded
    keep_picture(browser, "server-lost")
    start_dashboard_at(module_router, port=dashboard.port)
    browser.wait(f"{text_of('level')} == 'SAFE' && !document.body.classList.contains('cut')")


def test_a_degraded_sensor_shows_since_when_and_why(browser: Any, fusion: Fusion, url: str) -> None:
    fusion.sensor_state = "degraded"
    browser.open(url)
    row = browser.wait("document.querySelector('#sensors tr') && document.querySelector('#sensors tr').innerText")
    assert "degraded since" in row
    assert "lens blocked: 40 scans" in row
    browser.wait(
        "document.querySelector('#clocks tr') && document.querySelector('#clocks tr').innerText.includes('-10.25 ms')"
    )


@pytest.mark.parametrize("kind", ["recorded", "emulated", "simulated", "unknown"])
def test_a_band_says_what_is_not_live(browser: Any, fusion: Fusion, url: str, kind: str) -> None:
    browser.open(url)
    browser.wait(f"{text_of('level')} == 'SAFE' && document.getElementById('origin').hidden")
    fusion.source_kind = kind
    browser.wait(f"!document.getElementById('origin').hidden && {text_of('origin')}.startsWith('NOT LIVE, ')")
    assert f"LiDAR {kind}, radar {kind}, camera {kind}" in browser.run(text_of("origin"))
    assert kind in browser.wait("document.querySelector('#sensors tr').innerText")
    browser.run("document.getElementById('t-services').scrollIntoView()")
    browser.wait(f"{text_of('slim')}.includes('NOT LIVE')")
    browser.run("window.scrollTo(0, 0)")
    assert violations(browser) == []
    keep_picture(browser, f"origin-{kind}")
    fusion.source_kind = "live"
    browser.wait("document.getElementById('origin').hidden")


def test_a_running_recorder_is_shown_with_its_file_until_it_ends(
    browser: Any, fusion: Fusion, url: str, module_router: str
) -> None:
    browser.open(url)
    browser.wait(f"{text_of('recording')}.includes('no recorder')")
    config = ZenohConfig(connect=(module_router,))
    with open_session(config) as session, open_session(config) as witness:
        presence = RecorderPresence(session, "laptop1", witness)
        status = RecorderStatus(messages=1200, bytes=34_000_000, dropped=0, free_bytes=70 * 10**9, file="x/drive.mcap")
        presence.report(status)
        browser.wait(f"{text_of('recording')}.includes('Recording on laptop1: drive.mcap: 1200 messages, 34.0 MB')")
        presence.report(replace(status, dropped=3))
        browser.wait(f"{text_of('recording')}.includes('3 dropped')")
        assert "laptop1/recorder" in browser.run(text_of("services"))
        presence.end(status)
        browser.wait(f"{text_of('recording')}.includes('no recorder')")
        browser.wait(f"!{text_of('services')}.includes('laptop1/recorder')")  # and no red row stays behind


@pytest.mark.parametrize("level", ["SAFE", "CAUTION", "IMMINENT"])
def test_verdict_and_health_stay_while_the_page_is_scrolled(browser: Any, fusion: Fusion, url: str, level: str) -> None:
    fusion.level = level
    browser.open(url, 360, 740)
    browser.wait(f"{text_of('level')} == '{level}'")
    assert browser.run("document.getElementById('slim').hidden")
    browser.run("document.getElementById('t-services').scrollIntoView()")
    permission = {"SAFE": "GO", "CAUTION": "SLOW", "IMMINENT": "STOP"}[level]
    browser.wait(f"{text_of('slim')}.includes('{level} → {permission}')")
    assert "ALL VEHICLE SENSORS ONLINE" in browser.run(text_of("slim"))
    assert browser.run("document.getElementById('slim').getBoundingClientRect().top") == 0
    assert violations(browser) == []
    keep_picture(browser, f"slim-{level}")
    fusion.silent = True
    browser.wait(f"{text_of('slim')}.includes('NO VERDICT → STOP')")
    fusion.silent = False
    browser.run("window.scrollTo(0, 0)")
    browser.wait("document.getElementById('slim').hidden")


def test_a_phone_asks_for_what_is_on_its_screen(
    browser: Any, fusion: Fusion, url: str, module_router: str, until: Callable[..., None]
) -> None:
    """Pictures are made only once the camera's view is scrolled to, and no longer when it is left."""
    with Service("camera", ServiceConfig(host="jetson0", zenoh=ZenohConfig(connect=(module_router,)))) as camera:
        publish = camera.publisher(topics.CAMERA_IMAGE)

        def wanted_is(wanted: bool) -> bool:
            browser.run("0")  # a round trip: the page goes on
            return publish.wanted == wanted

        browser.open(url, 360, 740)
        browser.wait(f"{text_of('level')} == 'SAFE'")
        assert not publish.wanted
        for place, wanted in (("t-camera", True), ("level", False)):
            browser.run(f"document.getElementById('{place}').scrollIntoView()")
            until(partial(wanted_is, wanted), place, budget_s=20)


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize(("width", "height"), [(360, 740), (768, 1024), (1400, 1000), (3840, 2160)])
def test_it_fits_every_screen_and_can_be_read(
    browser: Any, fusion: Fusion, url: str, width: int, height: int, dark: bool
) -> None:
    fusion.level = "CAUTION"
    browser.errors.clear()
    browser.requests.clear()
    browser.open(url, width, height, dark)
    browser.wait(f"{text_of('level')} == 'CAUTION'")
    browser.wait("!!document.querySelector('#sensors tr')")
    assert browser.run("document.documentElement.scrollWidth <= window.innerWidth + 1"), "scrolls sideways"
    assert browser.run(CUT_OFF) == [], "part of a table is out of sight"
    assert violations(browser) == []
    assert all(asked.startswith((url, url.replace("http", "ws"))) for asked in browser.requests)
    assert browser.errors == []
    keep_picture(browser, f"page-{width}-{'dark' if dark else 'light'}")


def test_everything_can_be_reached_by_keyboard(browser: Any, fusion: Fusion, url: str) -> None:
    browser.open(url)
    browser.wait(f"{text_of('level')} == 'SAFE'")
    reached = set()
    for _ in range(12):
        browser.press("Tab")
        reached.add(browser.run("document.activeElement.id || document.activeElement.className"))
    assert {"skip", "sound", "rate", "cloud-toggle", "roadside-home"} <= reached
    browser.run("document.getElementById('sound').click()")
    assert browser.run("document.getElementById('sound').getAttribute('aria-pressed')") == "true"
