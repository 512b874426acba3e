"""Our tracker on the KITTI tracking sequences, scored by the rules of AB3DMOT, beside AB3DMOT's own figures.

    python -m benchmarks.datasets.kitti_tracking           # track the PointRCNN detections and score
    python -m benchmarks.datasets.kitti_tracking --results FOLDER  # score files: FOLDER/<sequence>.txt
    python -m benchmarks.datasets.kitti_tracking --write FOLDER  # keep our result files
    python -m benchmarks.datasets.kitti_tracking --held-out  # settings chosen on the other half of the sequences

The settings are the preset ``DETECTOR_TRACKING``, one for all sequences and all classes, and the detections are not
filtered. ``--halves`` shows each half of the sequences on its own.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from benchmarks.datasets.kitti_format import CLASSES, Rows, data_folder, read_detections, read_rows, write_rows
from benchmarks.datasets.kitti_rules import Summary, evaluate, prepare
from services.infra_lidar.tracking import Detections, MultiObjectTracker
from services.infra_lidar.tracking.config import TrackingConfig

LABELS = {"Car": "car", "Pedestrian": "pedestrian", "Cyclist": "cyclist"}
REFERENCE = {  # AB3DMOT of February 2022 on the same files: sAMOTA AMOTA AMOTP MOTA MOTP IDS FRAG FP FN
    "Car": (87.71, 40.34, 73.73, 78.36, 79.04, 0, 34, 750, 2645),
    "Pedestrian": (66.86, 24.89, 44.04, 62.93, 56.99, 0, 8, 11, 479),
    "Cyclist": (48.82, 17.23, 41.32, 32.49, 69.12, 0, 0, 40, 305),
}
DETECTOR_TRACKING = TrackingConfig(
    boxes="full", gate=16.27, velocity_sigma_mps=10.0, acceleration_sigma=3.0, initiate_confidence=0.7, confirm_hits=2,
    confirm_s=0.05,
)  # fmt: skip
"""For scored boxes of whole objects from a 3-D detector, seen from a vehicle whose own motion is not compensated.

The gate lets 99.9 % of a chi-square with 3 degrees of freedom pass: there is no clutter of pieces to keep out. In the
vehicle's frame, standing objects move at its speed and oncoming ones at up to twice that, and all of them decelerate
when it brakes: hence a wider prior of the velocity and more acceleration. Detections of low confidence update tracks,
but only confident ones initiate them (Zhang et al., ByteTrack, 2022); therefore two hits confirm."""
CANDIDATES = [
    replace(DETECTOR_TRACKING, gate=gate, initiate_confidence=confidence, confirm_hits=hits, confirm_s=confirm_s,
            velocity_sigma_mps=velocity, acceleration_sigma=acceleration)
    for gate in (7.81, 16.27)
    for confidence in (0.0, 0.7)
    for hits, confirm_s in ((1, 0.0), (2, 0.05), (3, 0.15))
    for velocity, acceleration in ((6.0, 2.0), (10.0, 3.0))
]  # fmt: skip
_FRAME_NS = 100_000_000


def track_sequence(detections: Rows, kind: str, settings: TrackingConfig = DETECTOR_TRACKING) -> Rows:
    """One sequence of one class: a row per confirmed track and frame, in the camera frame; coasting is not written."""
    tracker = MultiObjectTracker(settings)
    last_seen: dict[int, int] = {}
    rows: list[tuple[int, int, int, np.ndarray]] = []
    for frame in range(int(detections.frame.max(initial=-1)) + 2):
        index = np.flatnonzero(detections.frame == frame)
        tracks = tracker.update((frame + 1) * _FRAME_NS, _to_map(detections.take(index), kind))
        for track_id, hit in tracker.matches.items():
            last_seen[track_id] = int(index[hit])
        for track in tracks:
            if track.state == "confirmed":
                box = _to_camera(track.position_m, track.size_m, track.yaw_rad)
                rows.append((frame, track.track_id, last_seen[track.track_id], box))
    if not rows:
        return detections.take(np.empty(0, np.int64))
    source = detections.take(np.array([row[2] for row in rows]))
    return Rows(
        frame=np.array([row[0] for row in rows]),
        track=np.array([row[1] for row in rows]),
        kind=source.kind,
        truncated=source.truncated,
        occluded=source.occluded,
        box_px=source.box_px,
        box=np.array([row[3] for row in rows]),
        alpha=source.alpha,
        score=source.score,
    )


def _to_map(rows: Rows, kind: str) -> Detections:
    """Camera frame (x right, y down, z forward, bottom centre) to x forward, y left, z up, centre."""
    x, y, z, h, w, length, turn = rows.box.T
    return Detections(
        position_m=np.column_stack((z, -x, -y + h / 2)),
        size_m=np.column_stack((length, w, h)),
        yaw_rad=-turn - np.pi / 2,
        labels=[LABELS[kind]] * len(rows.frame),
        confidence=1.0 / (1.0 + np.exp(-rows.score)),
    )


def _to_camera(position: tuple[float, ...], size: tuple[float, ...], yaw: float) -> np.ndarray:
    length, width, height = size
    turn = (-yaw - np.pi / 2 + np.pi) % (2 * np.pi) - np.pi
    return np.array([-position[1], -position[2] + height / 2, position[0], height, width, length, turn])


def score_class(kind: str, results: dict[str, Rows], labels: dict[str, Rows]) -> Summary:
    """All given sequences of one class at once."""
    return evaluate([prepare(labels[name], results[name], kind) for name in sorted(labels)])


def table_row(name: str, summary: Summary) -> str:
    """sAMOTA, AMOTA, AMOTP, MOTA, MOTP in percent, then switches, fragments, false and missed."""
    best = summary.best
    shares = [summary.samota, summary.amota, summary.amotp, best.mota, best.motp]
    counts = [best.switches, best.fragments, best.false, best.misses]
    return f"{name:<24}" + "".join(f"{100 * v:9.2f}" for v in shares) + "".join(f"{v:7d}" for v in counts)


def print_class(kind: str, results: dict[str, Rows], labels: dict[str, Rows], halves: bool) -> None:
    """Our row of one class, AB3DMOT's own row, and ours of each half."""
    print(table_row(kind, score_class(kind, results, labels)), flush=True)
    print(f"{'  AB3DMOT':<24}" + "".join(f"{v:9.2f}" for v in REFERENCE[kind][:5])
          + "".join(f"{v:7d}" for v in REFERENCE[kind][5:]))  # fmt: skip
    for name, part in (("  half: even", slice(0, None, 2)), ("  half: odd", slice(1, None, 2))) if halves else ():
        chosen = sorted(labels)[part]
        print(table_row(name, score_class(kind, {n: results[n] for n in chosen}, {n: labels[n] for n in chosen})))


def main() -> None:
    """Print the table of all classes, or skip without the recordings."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--results", type=Path, help="score these result files instead of our tracker's")
    parser.add_argument("--write", type=Path, help="keep our result files here")
    parser.add_argument("--halves", action="store_true")
    parser.add_argument("--held-out", action="store_true")
    options, _ = parser.parse_known_args()
    folder = data_folder()
    if not folder.is_dir():
        print(f"kitti_tracking: skipped, no data in {folder} (set SPOTTER_DATA)")
        return
    labels = {path.stem: read_rows(path) for path in sorted((folder / "label").glob("*.txt"))}
    print(f"{'KITTI tracking, 3-D':<24}" + "".join(f"{n:>9}" for n in ("sAMOTA", "AMOTA", "AMOTP", "MOTA", "MOTP"))
          + "".join(f"{n:>7}" for n in ("IDS", "FRAG", "FP", "FN")))  # fmt: skip
    if options.held_out:
        for kind, results in held_out(labels, lambda name, kind: _detections(folder, name, kind)).items():
            print_class(kind, results, labels, True)
        return
    for kind in CLASSES:
        if options.results:
            results = {name: read_rows(options.results / f"{name}.txt") for name in labels}
        else:
            results = {name: _track_file(folder, name, kind) for name in labels}
        if options.write:
            for name, rows in results.items():
                options.write.joinpath(kind).mkdir(parents=True, exist_ok=True)
                write_rows(options.write / kind / f"{name}.txt", rows)
        print_class(kind, results, labels, options.halves)


def _track_file(folder: Path, name: str, kind: str) -> Rows:
    return track_sequence(_detections(folder, name, kind), kind)


def _detections(folder: Path, name: str, kind: str) -> Rows:
    return read_detections(folder / f"detections_{kind.lower()}" / f"{name}.txt", kind)


def held_out(labels: dict[str, Rows], detections: Callable[[str, str], Rows]) -> dict[str, dict[str, Rows]]:
    """Result rows by class and sequence, each half tracked with the settings that are best on the other half.

    Best is the sum of sAMOTA and MOTA over all classes: one setting for everything, out of 24 that differ in what was
    decided for ``DETECTOR_TRACKING``.
    """
    names = sorted(labels)
    halves = names[::2], names[1::2]
    sums = np.zeros((len(CANDIDATES), 2))
    rows: dict[tuple[int, str, str], Rows] = {}
    for number, settings in enumerate(CANDIDATES):
        for kind in CLASSES:
            rows |= {(number, kind, name): track_sequence(detections(name, kind), kind, settings) for name in names}
            for half, chosen in enumerate(halves):
                results = {name: rows[number, kind, name] for name in chosen}
                got = score_class(kind, results, {name: labels[name] for name in chosen})
                sums[number, half] += got.samota + got.best.mota
    best = sums.argmax(axis=0)
    for half, other in ((0, 1), (1, 0)):
        s, shipped = CANDIDATES[best[half]], sums[CANDIDATES.index(DETECTOR_TRACKING), other]
        print(f"chosen on the {('even', 'odd')[half]} half: gate {s.gate}, initiate {s.initiate_confidence}, hits "
              f"{s.confirm_hits}, velocity {s.velocity_sigma_mps}; sum of sAMOTA and MOTA on the other half "
              f"{sums[best[half], other]:.4f}, best there {sums[:, other].max():.4f}, shipped {shipped:.4f}",
              flush=True)  # fmt: skip
    return {
        kind: {name: rows[best[1 - number % 2], kind, name] for number, name in enumerate(names)} for kind in CLASSES
    }


if __name__ == "__main__":
    main()
