"""For ``spotter-infra-lidar look PATH``: what a ROS bag or files of points hold, and what to write to read them."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np

from common.config import ConfigError
from services.infra_lidar.input.bags import CLOUD, Bag, BagError, BagTopic, is_bag, open_bag, packets_of, points_in
from services.infra_lidar.input.pcd import FrameError
from services.infra_lidar.input.point_files import FRAME_SUFFIXES, frame_files, others_beside, parse_frame
from services.infra_lidar.input.sensors import SUPPORTED

MAX_FILES = 3  # of a folder that are read
MAX_NAMED = 5  # files of a folder without frames
MAX_MESSAGES = 50  # of a topic that are read: some seconds
COLUMNS = ["x", "y", "z", "intensity", "ring"]


def is_recording(path: Path) -> bool:
    """Whether it is a bag, a file of points or a folder, and not a capture."""
    return is_bag(path) or path.is_dir() or path.suffix.lower() in FRAME_SUFFIXES


def describe_recording(path: Path) -> Iterator[tuple[str, bool]]:
    """(line for a person, whether it names something that can be read).

    Raises:
        ConfigError: it does not exist, or is damaged.
    """
    if not path.exists():
        raise ConfigError(f"{path}: No such file or directory")
    if not is_bag(path):
        yield from _files(path)
        return
    try:
        with open_bag(path) as bag:
            topics = bag.topics()
            for topic in topics:
                yield from _topic(bag, topic, path)
            if not topics:
                others = "; ".join(f"{name} ({kind})" for name, kind in bag.all_topics) or "nothing"
                yield f"no clouds and no packets of a lidar that we know; in the bag: {others}", False
    except BagError as error:
        raise ConfigError(f"{path}: {error}") from None


def _topic(bag: Bag, topic: BagTopic, path: Path) -> Iterator[tuple[str, bool]]:
    stamps_ns: list[int] = []
    counts: list[int] = []
    wrong = ""
    for stamp_ns, message in islice(bag.messages(topic.name), MAX_MESSAGES):
        stamps_ns.append(stamp_ns)
        try:
            in_it = points_in(message, stamp_ns)[1] if topic.type == CLOUD else list(packets_of(message, stamp_ns))
            counts.append(len(in_it))
        except FrameError as error:
            wrong = str(error)
    span_s = (stamps_ns[-1] - stamps_ns[0]) * 1e-9 if len(stamps_ns) > 1 else 0.0
    rate = f", {(len(stamps_ns) - 1) / span_s:.1f} a second" if span_s > 0.0 else ""
    each = f" of {int(np.median(counts))} {'points' if topic.type == CLOUD else 'packets'}" if counts else ""
    what = f", {topic.model}" if topic.model else "" if topic.type == CLOUD else ", of no sensor that we know"
    yield f"{topic.name} ({topic.type}){what}: {topic.messages} messages{each}{rate}", False
    if wrong:
        yield f"    {wrong}", False
    if counts and (topic.type == CLOUD or topic.model.startswith(SUPPORTED)):
        yield f'    source = "file:{path}?topic={topic.name}"', True
    elif topic.model:
        yield "    not supported", False


def _files(path: Path) -> Iterator[tuple[str, bool]]:
    names = frame_files(path) if path.is_dir() else [path]
    if not names:
        there = ", ".join(sorted(p.name for p in path.iterdir())[:MAX_NAMED]) or "nothing"
        yield f"no frames ({' '.join(FRAME_SUFFIXES)}) in {path}; it holds {there}", False
        return
    readable = False
    for name in names[:MAX_FILES]:
        try:
            points = parse_frame(name.name, name.read_bytes()).points
        except FrameError as error:
            yield str(error), False
            continue
        readable = True
        reach_m = np.linalg.norm(points[:, :3], axis=1)
        held = ", ".join(COLUMNS[: points.shape[1]])
        yield f"{name.name}: {len(points)} points ({held}), {reach_m.min():.1f} to {reach_m.max():.1f} m away", False
    if path.is_dir():
        others = others_beside(path, names[0].suffix.lower())
        beside = f"; not read: {others}, as a source has one kind of files" if others else ""
        yield f"{len(names)} frames {names[0].suffix} in {path}{beside}", False
    if readable:
        yield f'    source = "file:{path}"', True
