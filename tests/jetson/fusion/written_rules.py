"""The decision rules a second time, as plain as possible and without any of fusion's code.

It writes the golden table and its rendering in the documentation:

    python tests/jetson/fusion/written_rules.py

Levels are numbers here (0 SAFE, 1 CAUTION, 2 IMMINENT, None nothing seen), states are strings, and every rule is an
``if`` in the order in which the rules are written down. It is slow and has no memory: it answers for the first moment.
"""

from __future__ import annotations

import csv
import importlib.util
import itertools
from collections.abc import Iterator
from pathlib import Path

HERE = Path(__file__).parent
GOLDEN = HERE / "golden_verdicts.csv"
DOCUMENT = HERE.parents[2] / "docs" / "fusion-table.md"

COLUMNS = (
    "lidar", "lidar_level", "radar", "radar_level", "radar_static", "camera", "camera_level", "camera_fresh", "moving",
    "level", "confirmed", "suppressed", "advisory", "blind", "permission",
)  # fmt: skip
NAMES = {None: "-", 0: "SAFE", 1: "CAUTION", 2: "IMMINENT"}
MOTIONS = ("yes", "no", "unknown")

# What can differ: an online sensor's band, a degraded one's alarm, and nothing of a disconnected one.
LIDARS = [("online", 0), ("online", 1), ("online", 2), ("degraded", None), ("degraded", 1), ("degraded", 2),
          ("disconnected", None)]  # fmt: skip
RADARS = [("online", level, static) for level in (0, 1, 2) for static in (None, 1, 2)]
RADARS += [("degraded", None, None), ("degraded", 1, None), ("degraded", 2, None), ("disconnected", None, None)]
CAMERAS = [("online", level, fresh) for level in (None, 0, 1, 2) for fresh in (True, False)]
CAMERAS += [("degraded", None, True), ("disconnected", None, True)]


def decide(lidar: tuple, radar: tuple, camera: tuple, moving: str) -> dict[str, object]:
    """One row of the table."""
    lidar_state, lidar_level = lidar
    radar_state, radar_level, static = radar
    camera_state, camera_level, fresh = camera

    # who may vote, and with what
    lidar_vote = -1
    if lidar_state == "online" or (lidar_state == "degraded" and lidar_level in (1, 2)):
        lidar_vote = lidar_level
    radar_vote = -1
    if radar_state == "online" or (radar_state == "degraded" and radar_level in (1, 2)):
        radar_vote = radar_level
    if lidar_state == "degraded" and radar_state == "online" and moving != "no" and static in (1, 2):
        radar_vote = max(radar_vote, static)
    camera_sees = camera_state == "online" and camera_level is not None

    # worst case of lidar and radar
    alarm = max(lidar_vote, radar_vote, 0)
    level = alarm
    confirmed = suppressed = False
    advisory = "-"

    if camera_sees and fresh and alarm >= 1 and camera_level >= 1:
        confirmed = True
        if lidar_state == "online":
            level = max(alarm, camera_level)
    if lidar_state != "online" and camera_sees:  # the camera stands in
        level = max(alarm, 1, camera_level)
    if lidar_state == "online" and camera_sees and alarm == 0 and camera_level >= 1:
        advisory = "CAMERA_ONLY"
    all_online = lidar_state == radar_state == camera_state == "online"
    if all_online and lidar_vote == 1 and radar_vote == 0 and not camera_sees and fresh:
        suppressed, level = True, 0

    # the floor
    out = sum(state != "online" for state in (lidar_state, radar_state, camera_state))
    if out >= 2:
        level = max(level, 1)
    blind = out == 3
    permission = "STOP" if blind else ("GO", "SLOW", "STOP")[level]
    return {
        "lidar": lidar_state, "lidar_level": NAMES[lidar_level],
        "radar": radar_state, "radar_level": NAMES[radar_level], "radar_static": NAMES[static],
        "camera": camera_state, "camera_level": NAMES[camera_level], "camera_fresh": "yes" if fresh else "no",
        "moving": moving, "level": NAMES[level], "confirmed": int(confirmed), "suppressed": int(suppressed),
        "advisory": advisory, "blind": int(blind), "permission": permission,
    }  # fmt: skip


def rows() -> Iterator[dict[str, object]]:
    """Every combination that can differ: 7 lidars x 13 radars x 10 cameras x 3 motions."""
    for combination in itertools.product(LIDARS, RADARS, CAMERAS, MOTIONS):
        yield decide(*combination)


def cell(row: dict[str, object]) -> str:
    mark = "¹" if row["suppressed"] else "²" if row["advisory"] != "-" else "³" if row["blind"] else ""
    return str(row["level"])[0] + mark


def label(state: str, level: int | None, nothing: str = "no alarm") -> str:
    if state == "disconnected":
        return state
    if state == "online" or level is not None:
        return f"{state}, {nothing if level is None else NAMES[level]}"
    return state


def table(radars: list, cameras: list, lidars: list, moving: str) -> list[str]:
    heads = [label(state, level) + (f", standing {NAMES[static]}" if static else "") for state, level, static in radars]
    lines = ["| Lidar | Camera | " + " | ".join(f"Radar {head}" for head in heads) + " |"]
    lines.append("|---|---|" + "---|" * len(heads))
    for lidar, camera in itertools.product(lidars, cameras):
        cells = [cell(decide(lidar, radar, camera, moving)) for radar in radars]
        seen = label(camera[0], camera[1], "nothing seen")
        lines.append(f"| {label(*lidar)} | {seen} | " + " | ".join(cells) + " |")
    return lines


def document() -> str:
    plain = [radar for radar in RADARS if radar[2] is None]
    standing = [radar for radar in RADARS if radar[2] is not None]
    fresh = [camera for camera in CAMERAS if camera[2]]
    old = [camera for camera in CAMERAS if not camera[2]]
    impaired = [lidar for lidar in LIDARS if lidar[0] == "degraded"]
    count = sum(1 for _ in rows())
    return "\n".join(
        [
            "# The verdict for every combination",
            "",
            "Generated by `tests/jetson/fusion/written_rules.py` from the written rules; the tests compare all",
            f"{count} combinations in `tests/jetson/fusion/golden_verdicts.csv` with what fusion decides. S SAFE,",
            "C CAUTION, I IMMINENT. It answers for one moment; what is remembered from moment to moment is below.",
            "",
            "¹ SAFE with `suppressed`: for at most 1.0 s of one lidar detection, then CAUTION; it ends at once when",
            "the range closes by 0.10 m or anybody else sees something. ² SAFE with `advisory` CAMERA_ONLY. ³ `blind`:",
            "the vehicle stops whatever the level.",
            "",
            "The table is for lidar, radar and camera. Any further sensor on the vehicle follows one rule,",
            "`N1-near-range`: online it votes with its band, degraded only with an alarm, disconnected not at all;",
            "the verdict is never lower than its vote, and its alarm ends a suppression. It counts in the floors:",
            "more than one of the vehicle's sensors out is at least C (`R7-two-out`), all of them out is `blind`",
            "(`R7-blind`). While it is online and clear, every level below stays as it is: `test_fourth_sensor.py`",
            "compares all rows.",
            "",
            "## Fresh picture, no standing radar tracks (any motion)",
            "",
            *table(plain, fresh, LIDARS, "yes"),
            "",
            "## Picture older than 0.5 s: it neither confirms nor suppresses (any motion)",
            "",
            *table(plain, old, LIDARS, "yes"),
            "",
            "## Lidar degraded, standing radar tracks, vehicle moving or its motion unknown",
            "",
            "Standing still, or with the lidar online or disconnected, standing tracks change nothing.",
            "",
            *table(standing, fresh, impaired, "yes"),
            "",
            *memory_sections(),
            "",
        ]
    )


def memory_sections() -> list[str]:
    """Part two of the page, from the file beside this one."""
    spec = importlib.util.spec_from_file_location("written_memory", HERE / "written_memory.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    sections: list[str] = module.sections()
    return sections


def write_golden(path: Path) -> None:
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows())


if __name__ == "__main__":
    write_golden(GOLDEN)
    DOCUMENT.parent.mkdir(exist_ok=True)
    DOCUMENT.write_text(document())
