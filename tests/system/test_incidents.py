"""Incidents that became regression tests: every verdict in them has to come out as it did then.

`spotter incident open NAME --out tests/incidents/NAME.mcap` adds one.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from common.recording.reader import read
from services.jetson.fusion.verify import verify

INCIDENTS = sorted((Path(__file__).parents[1] / "incidents").glob("*.mcap"))


@pytest.mark.parametrize("path", INCIDENTS, ids=lambda path: path.stem)
def test_an_incident_is_decided_as_it_was(path: Path) -> None:
    report = verify((one.key, one.payload) for one in read(path))
    assert report.difference == ""
    assert report.decided_again > 0
