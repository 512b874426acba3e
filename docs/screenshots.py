"""Takes the dashboard's pictures again: docs/dashboard.png and docs/states/*.png.

    python docs/screenshots.py

Starts the demo twice on free ports (scenarios ``crossing`` and ``faults``) and photographs the page in headless
Chromium when the state it waits for is there. Needs a Chromium, `make setup`, and about two minutes.
"""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from browser import CHROMIUM, Browser
from PIL import Image

from common.topics import spoken
from spotter_tools.ports import free_port

DOCS = Path(__file__).parent
STATES = DOCS / "states"
WIDTH, HEIGHT = 1400, 1500
START_S = 120.0
COLOURS = 256  # of a picture's palette: the page has few, its camera picture survives
ALARM = "['CAUTION', 'IMMINENT'].includes(document.getElementById('level').textContent)"
ALL_THERE = "document.querySelectorAll('#services tr').length >= 6 && !document.getElementById('camera').hidden"
RECORDED = "document.getElementById('recording').textContent.includes('Recording on')"
GREEN = "document.getElementById('health').className == 'health green'"
ALL_SEE = "[...document.querySelectorAll('#sensors tr')].every((row) => row.cells[1].textContent == 'online')"
STATE = (
    "[...document.querySelectorAll('#sensors tr')].some((row) => "
    "row.cells[0].textContent == '{sensor}' && row.cells[1].textContent.startsWith('{state}'))"
)


def only(**states: str) -> str:
    """The page shows these sensors in these states, and the others of the vehicle online."""
    wanted = {"lidar": "online", "radar": "online", "camera": "online"} | states
    return " && ".join(STATE.format(sensor=spoken(sensor), state=state) for sensor, state in wanted.items())


# File, what is waited for, how much of the page from its top.
OF_CROSSING = (
    ("verdict-safe", "document.getElementById('level').textContent == 'SAFE' && " + GREEN, 640),
    ("verdict-caution", "document.getElementById('level').textContent == 'CAUTION' && " + GREEN, 640),
    ("verdict-imminent", "document.getElementById('level').textContent == 'IMMINENT' && " + GREEN, 640),
)
OF_FAULTS = (
    ("lidar-degraded", only(lidar="degraded since"), 640),
    ("lidar-disconnected", only(lidar="disconnected since"), 640),
    ("camera-degraded", only(camera="degraded since"), 640),
    ("camera-disconnected", only(camera="disconnected since"), 640),
    ("radar-disconnected", only(radar="disconnected since"), 640),
    ("two-degraded", only(lidar="degraded since", camera="degraded since"), 640),
    ("blind", only(lidar="degraded since", camera="degraded since", radar="disconnected since"), 640),
)


def main() -> None:
    """Take all pictures; the words above."""
    if CHROMIUM is None:
        raise SystemExit("no Chromium on this machine")
    STATES.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as profile:
        browser = Browser(Path(profile))
        try:
            crossing(browser)
            faults(browser)
        finally:
            browser.close()


def crossing(browser: Browser) -> None:
    """The pictures of the crossing scenario, dark and on a phone."""
    with demo("crossing") as (process, url, endpoint), recorder(endpoint):
        browser.open(url, WIDTH, HEIGHT, dark=True)
        browser.wait(f"{ALL_THERE} && {GREEN} && {RECORDED}", START_S)
        browser.wait(f"{ALARM} && {ALL_SEE} && document.querySelectorAll('#ttc div').length > 0", START_S)
        take(browser, DOCS / "dashboard.png", HEIGHT, 1.0)
        photograph(browser, OF_CROSSING)
        browser.open(url, 390, 844, dark=False)
        browser.wait(f"{ALARM} && {ALL_SEE} && document.querySelectorAll('#sensors tr').length == 4", START_S)
        take(browser, STATES / "phone-light.png", 844, 1.0, width=390)
        browser.open(url, WIDTH, HEIGHT, dark=True)
        browser.wait(ALL_THERE, START_S)
        process.send_signal(signal.SIGINT)
        browser.wait("document.body.classList.contains('cut')", START_S)
        take(browser, STATES / "server-lost.png", 640, 0.5)


def faults(browser: Browser) -> None:
    """The pictures of the faults scenario."""
    with demo("faults") as (_, url, _):
        browser.open(url, WIDTH, HEIGHT, dark=True)
        browser.wait(ALL_THERE, START_S)
        photograph(browser, OF_FAULTS)


def photograph(browser: Browser, states: tuple[tuple[str, str, int], ...]) -> None:
    """One picture per state, when the page shows it."""
    for name, condition, height in states:
        browser.wait(condition, START_S)
        take(browser, STATES / f"{name}.png", height, 0.5)


def take(browser: Browser, path: Path, height: int, scale: float, width: int = WIDTH) -> None:
    """The top of the page, with a small palette so that the repository stays small."""
    browser.picture(path, width, height, scale)
    with Image.open(io.BytesIO(path.read_bytes())) as picture:
        picture.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
    sys.stdout.write(f"{path.relative_to(DOCS.parent)}  {path.stat().st_size / 1000:.0f} kB\n")
    sys.stdout.flush()


@contextmanager
def demo(scenario: str) -> Iterator[tuple[subprocess.Popen[bytes], str, str]]:
    """The whole demo as a process, its dashboard's address and its router's endpoint."""
    port, endpoint = free_port(), f"tcp/127.0.0.1:{free_port()}"
    command = [
        str(Path(sys.executable).with_name("spotter")), "demo", "--scenario", scenario, "--port", str(port),
        "--listen", endpoint,
    ]  # fmt: skip
    with subprocess.Popen(command, stderr=subprocess.PIPE, env=os.environ) as process:
        assert process.stderr is not None
        try:
            for line in process.stderr:
                if b"Spotter is up" in line:
                    break
            else:
                raise SystemExit(f"the demo `{scenario}` ended before it was up")
            threading.Thread(target=process.stderr.read, daemon=True).start()
            yield process, f"http://127.0.0.1:{port}", endpoint
        finally:
            process.send_signal(signal.SIGINT)


@contextmanager
def recorder(endpoint: str) -> Iterator[None]:
    """`spotter record` beside it, which the page tells."""
    spotter = str(Path(sys.executable).with_name("spotter"))
    with tempfile.TemporaryDirectory() as folder:
        command = [spotter, "record", folder, "--host", "laptop1", "--connect", endpoint, "--json"]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
            yield
            process.terminate()


if __name__ == "__main__":
    main()
