"""Labelled clusters from folders in the article's layout: ``{train,test}/<class>/*.bin``. Opens files.

A folder that is not laid out like this is refused with one sentence.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from common.config import ConfigError
from services.infra_lidar.classification.classes import CLASSES
from services.infra_lidar.training.clusters import LabelledClusters, collect

FOLDER_CLASSES = {name: name for name in CLASSES} | {
    "bicyclist": "cyclist", "bicycle": "cyclist", "bus": "large_vehicle", "truck": "large_vehicle",
    "person": "pedestrian",
}  # fmt: skip
LARGEST_MEDIAN_M = 30.0  # half of the clusters are longer: then these are no metres, or no x y z
SMALLEST_MEDIAN_M = 0.05  # half of the clusters are shorter: these may be kilometres
LONGEST_M = 60.0  # no road user is longer
ROWS = range(4, 9)  # values a row that are looked for besides x y z
CLEAR_GAIN = 0.02  # by as much have longer rows to explain the numbers better than rows of three
CLEAR_SIGMAS = 5.0  # and by as much of what chance explains
OTHER_FILES = (".npy", ".npz", ".pcd", ".ply", ".las", ".laz", ".csv", ".txt", ".xyz")
_LAYOUT = "expected {train,test}/<class>/*.bin"


def read_part(folder: Path, part: str, min_points: int = 5) -> LabelledClusters:
    """Clusters of ``folder/part``, which is ``train`` or ``test``: float32 x y z, one cluster a file.

    The ground is at a cluster's lowest point. Names of our classes and of the article's (``bicyclist``) are understood.
    Every file is a group of its own unless its name begins with ``<group>_``, a number.

    Raises:
        ConfigError: not there, empty, of other classes, with other files among them, or not in metres.
    """
    if not folder.exists():
        raise ConfigError(f"{folder}: no such folder; {_LAYOUT}")
    if not folder.is_dir():
        raise ConfigError(f"{folder}: a file; {_LAYOUT} in a folder")
    there = sorted(path.name for path in folder.iterdir() if not path.name.startswith("."))
    if part not in there:
        found = ", ".join(there[:6]) or "nothing"
        raise ConfigError(f"{folder}: no folder {part} in it, but {found}; {_LAYOUT}")
    return read_folder(folder / part, min_points)


def read_folder(folder: Path, min_points: int = 5) -> LabelledClusters:
    """Clusters of ``folder/<class>/*.bin``, see ``read_part``. Clusters of fewer than ``min_points`` are left out."""
    read = {path: _points(path) for path in _files(folder)}
    clusters = {path: points for path, points in read.items() if len(points) >= min_points}
    if not clusters:
        raise ConfigError(f"{folder}: none of {len(read)} clusters has {min_points} points")
    labels: list[int] = []
    groups: list[int] = []
    for path in clusters:
        labels.append(CLASSES.index(FOLDER_CLASSES[path.parent.name]))
        prefix = path.stem.split("_")[0]
        groups.append(int(prefix) if "_" in path.stem and prefix.isdigit() else 1_000_000 + len(groups))
    _expect_rows_of_three(clusters)
    _expect_metres(folder, clusters)
    points = list(clusters.values())
    return collect(points, [float(cluster[:, 2].min()) for cluster in points], labels, groups)


def expect_classes(clusters: LabelledClusters, folder: Path) -> None:
    """Refuse clusters from which no forest can learn: of one class, or of one group.

    Raises:
        ConfigError: there is nothing to tell apart.
    """
    present = [CLASSES[c] for c in np.unique(clusters.labels)]
    if len(present) < 2:
        raise ConfigError(f"{folder}: only {present[0]}: a forest needs clusters of two classes at least")
    if len(np.unique(clusters.groups)) < 2:
        raise ConfigError(f"{folder}: all clusters are of one group (the number before `_`): two are needed at least")


def _files(folder: Path) -> list[Path]:
    entries = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    known = [path for path in entries if path.is_dir()]
    wrong = [path.name for path in known if path.name not in FOLDER_CLASSES]
    names = ", ".join(sorted(FOLDER_CLASSES))
    if wrong:
        raise ConfigError(f"{folder}: no class of ours: {', '.join(wrong)}; known: {names}")
    if not known:
        there = ", ".join(path.name for path in entries[:6]) or "nothing"
        raise ConfigError(f"{folder}: expected a folder for each class ({names}); found {there}")
    inside = [path for one in known for path in sorted(one.iterdir()) if not path.name.startswith(".")]
    other = [path for path in inside if path.suffix.lower() in OTHER_FILES]
    if other:
        raise ConfigError(f"{other[0]}: not a .bin of float32 x y z ({len(other)} such files): convert or remove them")
    files = [path for path in inside if path.suffix == ".bin"]
    if not files:
        raise ConfigError(f"{folder}: no .bin files in {', '.join(path.name for path in known)}")
    return files


def _points(path: Path) -> np.ndarray:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    if len(data) % 12:
        raise ConfigError(f"{path}: expected float32 x y z, rows of 12 bytes, got {len(data)} bytes")
    points = np.frombuffer(data, "<f4").reshape(-1, 3)
    if not np.isfinite(points).all():
        raise ConfigError(f"{path}: expected float32 x y z, finite, got other numbers")
    return points


def _expect_rows_of_three(clusters: dict[Path, np.ndarray]) -> None:
    """Refuse a class whose numbers repeat with another period than three: a row of x y z and more."""
    for place in sorted({path.parent for path in clusters}):
        values = [points.ravel().astype(float) for path, points in clusters.items() if path.parent == place]
        plain, _ = _explained(values, 3)
        for width in ROWS:
            if any(len(one) % width for one in values):
                continue
            share, chance = _explained(values, width)
            if share - plain > max(CLEAR_GAIN, CLEAR_SIGMAS * chance):
                raise ConfigError(f"{place}: expected float32 x y z, found numbers that look like rows of {width}")


def _explained(files: list[np.ndarray], width: int) -> tuple[float, float]:
    """Share of the variance within files that places in rows of so many explain, less what chance does; its sigma."""
    sizes = [(np.sign(one) * np.log1p(np.abs(one))).reshape(-1, width) for one in files]
    within = sum(float(((rows - rows.mean(axis=0)) ** 2).sum()) for rows in sizes)
    total = sum(float(((rows - rows.mean()) ** 2).sum()) for rows in sizes)
    count = sum(rows.size for rows in sizes)
    left, all_free = count - width * len(sizes), count - len(sizes)
    if left <= 0 or total <= 0.0:
        return 0.0, 1.0
    return 1.0 - (within / left) / (total / all_free), float(np.sqrt(2.0 * (width - 1) * len(sizes))) / left


def _expect_metres(folder: Path, clusters: dict[Path, np.ndarray]) -> None:
    lengths_m = {path: float(np.linalg.norm(np.ptp(one.astype(float), axis=0))) for path, one in clusters.items()}
    median_m = float(np.median(list(lengths_m.values())))
    if median_m > LARGEST_MEDIAN_M:
        raise ConfigError(
            f"{folder}: half of the clusters are longer than {median_m:.0f}: expected metres, x y z; are these "
            f"millimetres, or rows with more columns?"
        )
    if median_m < SMALLEST_MEDIAN_M:
        raise ConfigError(
            f"{folder}: half of the clusters are at most {median_m:.2g} long: expected metres, x y z; are these "
            f"kilometres?"
        )
    for path, length_m in lengths_m.items():
        if length_m > LONGEST_M and FOLDER_CLASSES[path.parent.name] != "background":
            raise ConfigError(f"{path}: {length_m:.0f} m long, expected one road user of at most {LONGEST_M:.0f} m")
