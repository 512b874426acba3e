"""Every combination of state, level and motion against the golden table."""

from __future__ import annotations

import csv
import itertools
from pathlib import Path
from typing import Any

import pytest

from services.jetson.fusion.verdict import RULES, FusionInputs, FusionMemory, SensorInput, fuse
from tests.jetson.fusion import written_rules

HERE = Path(__file__).parent
GOLDEN = HERE / "golden_verdicts.csv"
KEY = ("lidar", "lidar_level", "radar", "radar_level", "radar_static", "camera", "camera_level", "camera_fresh")
MOVING = {"yes": True, "no": False, "unknown": None}
STATES = ("online", "degraded", "disconnected")
LEVELS: tuple[Any, ...] = (None, "SAFE", "CAUTION", "IMMINENT")


def level(text: str) -> Any:
    return None if text == "-" else text


def inputs_of(row: dict[str, str]) -> FusionInputs:
    return FusionInputs(
        now_s=100.0,
        moving=MOVING[row["moving"]],
        lidar=SensorInput(state=row["lidar"], level=level(row["lidar_level"]), age_s=0.02),  # type: ignore[arg-type]
        radar=SensorInput(
            state=row["radar"],  # type: ignore[arg-type]
            level=level(row["radar_level"]),
            age_s=0.05,
            static_level=level(row["radar_static"]),
        ),
        camera=SensorInput(
            state=row["camera"],  # type: ignore[arg-type]
            level=level(row["camera_level"]),
            age_s=0.1 if row["camera_fresh"] == "yes" else 0.7,
        ),
    )


def outcome(verdict: Any) -> tuple[Any, ...]:
    flags = (verdict.confirmed, verdict.suppressed, verdict.advisory or "-", verdict.blind)
    return (verdict.level, *flags, verdict.permission)


def expected(row: dict[str, str]) -> tuple[Any, ...]:
    flags = [bool(int(row[name])) for name in ("confirmed", "suppressed", "blind")]
    return (row["level"], flags[0], flags[1], row["advisory"], flags[2], row["permission"])


@pytest.fixture(scope="module")
def golden() -> list[dict[str, str]]:
    with GOLDEN.open() as file:
        return list(csv.DictReader(file))


def test_every_golden_row(golden: list[dict[str, str]]) -> None:
    assert len(golden) == 7 * 13 * 10 * 3
    for row in golden:
        verdict, _ = fuse(inputs_of(row), FusionMemory())
        assert outcome(verdict) == expected(row), row
        assert verdict.rule in RULES


def test_all_raw_combinations_fall_into_a_golden_row(golden: list[dict[str, str]]) -> None:
    """All 41 472: what a sensor that is out may not say any more makes no difference."""
    by_key = {tuple(row[name] for name in (*KEY, "moving")): row for row in golden}
    count = 0
    for lidar, radar, camera in itertools.product(STATES, repeat=3):
        for one, two, static, seen in itertools.product(LEVELS, repeat=4):
            for fresh, moving in itertools.product(("yes", "no"), MOVING):
                count += 1
                raw = dict(
                    zip((*KEY, "moving"), (lidar, one, radar, two, static, camera, seen, fresh, moving), strict=True)
                )
                row = by_key[canonical(raw)]
                verdict, _ = fuse(inputs_of({name: value or "-" for name, value in raw.items()}), FusionMemory())
                assert outcome(verdict) == expected(row), raw
    assert count == 41_472


def canonical(raw: dict[str, Any]) -> tuple[str, ...]:
    """The golden row's key of a raw combination."""

    def ranging(state: str, reported: Any) -> str:
        alarm = reported in ("CAUTION", "IMMINENT")
        if state == "online":
            return str(reported or "SAFE")
        return str(reported) if state == "degraded" and alarm else "-"

    static = raw["radar_static"] if raw["radar"] == "online" and raw["radar_static"] in LEVELS[2:] else "-"
    seeing = raw["camera"] == "online"
    return (
        raw["lidar"], ranging(raw["lidar"], raw["lidar_level"]),
        raw["radar"], ranging(raw["radar"], raw["radar_level"]), static,
        raw["camera"], (raw["camera_level"] or "-") if seeing else "-", raw["camera_fresh"] if seeing else "yes",
        raw["moving"],
    )  # fmt: skip


# The published decision table, typed in by hand: lidar, camera, then radar SAFE, CAUTION, IMMINENT, disconnected.
PUBLISHED = """
online SAFE         | online -        | S C I S
online SAFE         | online SAFE     | S C I S
online SAFE         | online CAUTION  | S2 C I S2
online SAFE         | online IMMINENT | S2 I I S2
online SAFE         | degraded        | S C I C
online SAFE         | disconnected    | S C I C
online CAUTION      | online -        | S1 C I C
online CAUTION      | online SAFE     | C C I C
online CAUTION      | online CAUTION  | C C I C
online CAUTION      | online IMMINENT | I I I I
online CAUTION      | degraded        | C C I C
online CAUTION      | disconnected    | C C I C
online IMMINENT     | online -        | I I I I
online IMMINENT     | online SAFE     | I I I I
online IMMINENT     | online CAUTION  | I I I I
online IMMINENT     | online IMMINENT | I I I I
online IMMINENT     | degraded        | I I I I
online IMMINENT     | disconnected    | I I I I
degraded            | online -        | S C I C
degraded            | online SAFE     | C C I C
degraded            | online CAUTION  | C C I C
degraded            | online IMMINENT | I I I I
degraded            | degraded        | C C I C3
degraded            | disconnected    | C C I C3
disconnected        | online -        | S C I C
disconnected        | online SAFE     | C C I C
disconnected        | online CAUTION  | C C I C
disconnected        | online IMMINENT | I I I I
disconnected        | degraded        | C C I C3
disconnected        | disconnected    | C C I C3
"""


def test_the_golden_table_is_the_published_one(golden: list[dict[str, str]]) -> None:
    radars = ["online SAFE", "online CAUTION", "online IMMINENT", "disconnected"]
    cells = {}
    for row in golden:
        if row["radar_static"] == "-" and row["camera_fresh"] == "yes" and row["moving"] == "yes":
            names = [
                row[sensor] + (f" {row[f'{sensor}_level']}" if row[sensor] == "online" else "")
                for sensor in ("lidar", "camera", "radar")
                if row[sensor] == "online" or row[f"{sensor}_level"] == "-"
            ]
            mark = (
                "1"
                if row["suppressed"] == "1"
                else "2"
                if row["advisory"] != "-"
                else "3"
                if row["blind"] == "1"
                else ""
            )
            cells[tuple(names)] = row["level"][0] + mark
    checked = 0
    for line in PUBLISHED.strip().splitlines():
        lidar, camera, wanted = (part.strip() for part in line.split("|"))
        for radar, cell in zip(radars, wanted.split(), strict=True):
            assert cells[lidar, camera, radar] == cell, (lidar, camera, radar)
            checked += 1
    assert checked == 120


def test_golden_file_and_documentation_are_what_the_written_rules_say(tmp_path: Path) -> None:
    written_rules.write_golden(tmp_path / "golden.csv")
    assert (tmp_path / "golden.csv").read_text() == GOLDEN.read_text(), "run tests/jetson/fusion/written_rules.py"
    assert written_rules.DOCUMENT.read_text() == written_rules.document(), "run tests/jetson/fusion/written_rules.py"
