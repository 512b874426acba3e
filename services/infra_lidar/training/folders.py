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
    clusters: list[np.ndarray] = []
    labels: list[int] = []
    groups: list[int] = []
    too_small = 0
    for path in _files(folder):
        points = _points(path)
        if len(points) < min_points:
            too_small += 1
            continue
        clusters.append(points)
        labels.append(CLASSES.index(FOLDER_CLASSES[path.parent.name]))
        prefix = path.stem.split("_")[0]
        groups.append(int(prefix) if "_" in path.stem and prefix.isdigit() else 1_000_000 + len(groups))
    if not clusters:
        raise ConfigError(f"{folder}: none of {too_small} clusters has {min_points} points")
    _expect_metres(folder, clusters)
    return collect(clusters, [float(points[:, 2].min()) for points in clusters], labels, groups)


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


def _expect_metres(folder: Path, clusters: list[np.ndarray]) -> None:
    lengths_m = [float(np.linalg.norm(np.ptp(points.astype(float), axis=0))) for points in clusters]
    median_m = float(np.median(lengths_m))
    if median_m > LARGEST_MEDIAN_M:
        raise ConfigError(
            f"{folder}: half of the clusters are longer than {median_m:.0f}: expected metres, x y z; are these "
            f"millimetres, or rows with more columns?"
        )
