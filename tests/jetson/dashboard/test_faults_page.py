"""The demo's scenario `faults` on the page: one sensor after the other fails, then two at once, then all.

The conditions that ``docs/screenshots.py`` waits for before it takes a picture; whichever comes first in the loop.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import pytest

DOCS = Path(__file__).parents[3] / "docs"
BARS = {
    "lidar-degraded": ("amber", "LiDAR DEGRADED"),
    "lidar-disconnected": ("amber", "LiDAR DISCONNECTED"),
    "camera-degraded": ("amber", "camera DEGRADED"),
    "camera-disconnected": ("amber", "camera DISCONNECTED"),
    "radar-disconnected": ("amber", "radar DISCONNECTED"),
    "two-degraded": ("red", "LiDAR DEGRADED + camera DEGRADED"),
    "blind": ("red", "SYSTEM BLIND"),
}


def bar_says(colour: str, words: str) -> str:
    """The health bar has the words and their colour."""
    bar = "document.getElementById('health')"
    return f"{bar}.textContent.includes('{words}') && {bar}.className == 'health {colour}'"


@pytest.mark.slow
def test_each_fault_of_the_scenario_is_on_the_page(browser: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The row says it, the bar says it in its colour, nothing else is blamed, and the console has no errors."""
    monkeypatch.syspath_prepend(str(DOCS))
    screenshots = importlib.import_module("screenshots")
    assert [name for name, _, _ in screenshots.OF_FAULTS] == list(BARS)
    browser.errors.clear()
    with screenshots.demo("faults") as (_, url, _):
        browser.open(url)
        browser.wait(screenshots.ALL_THERE, screenshots.START_S)
        awaited = {name: f"{condition} && {bar_says(*BARS[name])}" for name, condition, _ in screenshots.OF_FAULTS}
        while awaited:
            browser.wait(" || ".join(f"({condition})" for condition in awaited.values()), screenshots.START_S)
            awaited = {name: condition for name, condition in awaited.items() if not browser.run(condition)}
        browser.wait(f"{screenshots.GREEN} && {screenshots.only()}", screenshots.START_S)
    assert browser.errors == []
