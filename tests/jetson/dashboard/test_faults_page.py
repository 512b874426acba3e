"""The demo's scenario `faults` on the page: one sensor after the other fails, then two at once, then all.

The same conditions, in the same order, as ``docs/screenshots.py`` waits for before it takes a picture.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import pytest

DOCS = Path(__file__).parents[3] / "docs"
BARS = {
    "lidar-degraded": ("amber", "LIDAR DEGRADED"),
    "lidar-disconnected": ("amber", "LIDAR DISCONNECTED"),
    "camera-degraded": ("amber", "CAM DEGRADED"),
    "camera-disconnected": ("amber", "CAM DISCONNECTED"),
    "radar-disconnected": ("amber", "RADAR DISCONNECTED"),
    "two-degraded": ("red", "LIDAR DEGRADED + CAM DEGRADED"),
    "blind": ("red", "SYSTEM BLIND"),
}


@pytest.mark.system
@pytest.mark.slow
def test_each_fault_of_the_scenario_is_on_the_page(browser: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The row says it, the bar says it in its colour, nothing else is blamed, and the console has no complaint."""
    monkeypatch.syspath_prepend(str(DOCS))
    screenshots = importlib.import_module("screenshots")
    assert [name for name, _, _ in screenshots.OF_FAULTS] == list(BARS)
    browser.complaints.clear()
    with screenshots.demo("faults") as (_, url, _):
        browser.open(url)
        browser.wait(screenshots.ALL_THERE, screenshots.START_S)
        for name, condition, _ in screenshots.OF_FAULTS:
            colour, words = BARS[name]
            bar = f"document.getElementById('health').textContent.includes('{words}')"
            painted = f"document.getElementById('health').className == 'health {colour}'"
            browser.wait(f"{condition} && {bar} && {painted}", screenshots.START_S)
        browser.wait(f"{screenshots.GREEN} && {screenshots.only()}", screenshots.START_S)
    assert browser.complaints == []
