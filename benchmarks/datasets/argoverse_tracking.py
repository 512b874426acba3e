"""The tracker on real ways of cars and people (Argoverse 2) with noise and dropouts added: MOTA, IDF1, velocity.

Detections are the labelled boxes in world coordinates, moved by noise, now and then missing, now and then with half of
their length hidden, with another class in one of ten, and with false ones besides. Seeded; no tuning to these tracks.
"""

from __future__ import annotations

import csv
from collections import defaultdict
from pathlib import Path

import numpy as np

from benchmarks.datasets.kitti_format import data_folder
from benchmarks.datasets.tracking_metrics import TrackingScore
from services.infra_lidar.config import TrackingConfig
from services.infra_lidar.tracking import Detections, MultiObjectTracker

CLASSES = {
    "REGULAR_VEHICLE": "car", "LARGE_VEHICLE": "large_vehicle", "BUS": "large_vehicle", "BOX_TRUCK": "large_vehicle",
    "TRUCK": "large_vehicle", "PEDESTRIAN": "pedestrian", "BICYCLIST": "cyclist", "MOTORCYCLIST": "cyclist",
}  # fmt: skip
Row = tuple[int, str, np.ndarray, np.ndarray, float]  # track, class, position, size, yaw


def read_log(folder: Path, reach_m: float = 60.0) -> list[list[Row]]:
    """Frames of labelled boxes within reach of the vehicle, world coordinates."""
    frames: dict[int, list[Row]] = defaultdict(list)
    numbers: dict[str, int] = {}
    with (folder / "annotations.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            kind = CLASSES.get(row["category"])
            if kind and np.hypot(float(row["x"]), float(row["y"])) < reach_m and int(row["points_inside"]) >= 5:
                track = numbers.setdefault(row["track"], len(numbers))
                place = np.array([float(row["world_x"]), float(row["world_y"]), float(row["world_z"])])
                size = np.array([float(row[name]) for name in ("length", "width", "height")])
                frames[int(row["frame"])].append((track, kind, place, size, float(row["world_yaw"])))
    return [frames[number] for number in range(max(frames) + 1)]


def spoil(rows: list[Row], rng: np.random.Generator, noise_m: float, dropout: float) -> Detections:
    """Boxes as a lidar's clustering might give them."""
    kept = [row for row in rows if rng.random() > dropout]
    position, size, yaw, labels = [], [], [], []
    for _, kind, place, box, turn in kept:
        hidden = rng.uniform(0.0, 0.5) if rng.random() < 0.3 else 0.0
        along = np.array([np.cos(turn), np.sin(turn), 0.0])
        position.append(place - 0.5 * hidden * box[0] * along + rng.normal(0, noise_m, 3))
        size.append(box * [1.0 - hidden, 1.0, 1.0])
        yaw.append(turn + rng.choice([0.0, np.pi]))
        labels.append(kind if rng.random() < 0.9 else str(rng.choice(["unknown", "car", "pedestrian", "cyclist"])))
    for _ in range(rng.poisson(1.0)):
        centre = rows[0][2] if rows else np.zeros(3)
        position.append(centre + rng.uniform(-40, 40, 3) * [1, 1, 0.02])
        size.append(rng.uniform(0.3, 3.0, 3))
        yaw.append(rng.uniform(-3, 3))
        labels.append("unknown")
    count = len(labels)
    return Detections(
        np.reshape(position, (count, 3)), np.reshape(size, (count, 3)), np.array(yaw), labels, np.full(count, 0.8)
    )


def score_log(frames: list[list[Row]], noise_m: float, dropout: float) -> tuple[TrackingScore, list[float]]:
    """Tracks of road users against the labels, and the velocity errors of what moves."""
    tracker, rng, score, errors = MultiObjectTracker(TrackingConfig()), np.random.default_rng(7), TrackingScore(), []
    before: dict[int, np.ndarray] = {}
    for number, rows in enumerate(frames):
        tracks = tracker.update((number + 1) * 100_000_000, spoil(rows, rng, noise_m, dropout))
        shown = [t for t in tracks if t.state != "tentative" and t.label != "unknown"]
        matched = len(score.pairs)
        score.add(
            np.array([row[0] for row in rows]), np.array([row[2][:2] for row in rows]),
            np.array([1.0 if row[1] in ("pedestrian", "cyclist") else 2.5 for row in rows]), np.zeros(len(rows), bool),
            np.array([t.track_id for t in shown], int), np.array([t.position_m[:2] for t in shown]),
        )  # fmt: skip
        speed = {row[0]: (row[2][:2] - before[row[0]]) / 0.1 for row in rows if row[0] in before}
        by_id = {t.track_id: t for t in shown}
        for _, truth, track in score.pairs[matched:]:
            if truth in speed:
                errors.append(float(np.hypot(*(np.array(by_id[track].velocity_mps[:2]) - speed[truth]))))
        before = {row[0]: row[2][:2] for row in rows}
    return score, errors


def main() -> None:
    """Print MOTA, IDF1, switches and velocity error of every log at three grades of spoiling, or skip."""
    folder = data_folder().parent / "labelled-argoverse2"
    logs = sorted(folder.glob("log_*"))
    if not logs:
        print(f"argoverse_tracking: skipped, no data in {folder} (set SPOTTER_DATA)")
        return
    print(f"{'log':<14}{'noise m':>8}{'dropout':>9}{'MOTA':>8}{'IDF1':>8}{'switches':>9}{'v err m/s':>10}")
    for log in logs:
        frames = read_log(log)
        for noise_m, dropout in ((0.0, 0.0), (0.1, 0.1), (0.2, 0.3)):
            score, errors = score_log(frames, noise_m, dropout)
            print(f"{log.name:<14}{noise_m:8.1f}{dropout:9.1f}{score.mota:8.3f}{score.idf1:8.3f}{score.switches:9d}"
                  f"{np.median(errors):10.2f}")  # fmt: skip


if __name__ == "__main__":
    main()
