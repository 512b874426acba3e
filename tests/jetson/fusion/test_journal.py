"""The log says what changed, once."""

from __future__ import annotations

from typing import Any

import pytest

from services.jetson.fusion.journal import Journal


def test_changes_are_logged_once_with_their_reason(bench: Any, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    journal = Journal()

    def log_for(seconds: float) -> list[str]:
        caplog.clear()
        for _ in range(round(seconds / 0.05)):
            journal.note_verdict(bench.tick())
            journal.note_health(bench.health)
        return [record.getMessage() for record in caplog.records]

    first = log_for(0.5)
    assert first[0] == "SAFE -> GO by R0-clear: LiDAR, radar, camera see nothing near"
    assert "radar online" in first
    assert log_for(1.0) == []

    bench.levels["radar"] = "IMMINENT"
    (line,) = log_for(0.3)
    assert line.startswith("IMMINENT -> STOP by R1-worst-case: radar IMMINENT at 1.00 m; lower when: radar")

    bench.kill("radar")
    assert log_for(1.0) == ["radar disconnected: radar on pi0 has ended"], "the alarm stays"
    bench.start("radar")
    bench.levels["radar"] = "SAFE"
    lines = log_for(2.0)
    assert "radar online" in lines
    assert lines[-1].startswith("SAFE -> GO")
