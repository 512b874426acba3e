"""Multi-object tracking of labelled boxes: predict, associate, update, judge, retire, found.

Stacked constant-velocity Kalman filters (``tracking_filter``), Mahalanobis gate and Hungarian assignment with a soft
class term (``tracking_assign``), edge-aware box measurements, size, heading and the test that decides whether a track
moves at all (``tracking_shape``). Lifetimes are seconds, not frames. No clock, no I/O: the time is ``stamp_ns``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import get_args

import numpy as np

from common.messages import ObjectLabel, ObjectTrack, check_shape
from services.infra_lidar.classes import CLASSES, LABELS
from services.infra_lidar.tracking_assign import cheapest
from services.infra_lidar.tracking_config import TrackingConfig
from services.infra_lidar.tracking_filter import DETECTION, TRACK, TRAIL, parameters
from services.infra_lidar.tracking_life import TrackTable, tell
from services.infra_lidar.tracking_step import candidates, conclude, describe, keep

assert set(LABELS) == set(get_args(ObjectLabel))

_LABEL_INDEX: dict[str, int] = {label: index for index, label in enumerate(LABELS)}
_IDENTITY = np.eye(4)
_NO_POINTS, _NO_CHANCES = np.zeros(0, np.int64), np.zeros((0, len(CLASSES)))


@dataclass(frozen=True)
class Detections:
    """K boxes of one frame, metres and radians.

    ``position_m`` (K, 3) centre, ``size_m`` (K, 3) length, width, height, ``yaw_rad`` (K,), ``labels`` (K,) of
    ``LABELS`` or their index in it, ``confidence`` (K,) in 0..1, ``points`` (K,) or None, ``probabilities`` (K, C) over
    ``CLASSES`` or None (then they follow from label and confidence), ``T_map_source`` (4, 4): their frame, upright, in
    the map frame.
    """

    position_m: np.ndarray
    size_m: np.ndarray
    yaw_rad: np.ndarray
    labels: Sequence[str] | np.ndarray
    confidence: np.ndarray
    points: np.ndarray | None = None
    probabilities: np.ndarray | None = None
    T_map_source: np.ndarray = field(default_factory=lambda: _IDENTITY)

    def __post_init__(self) -> None:
        count = len(self.labels)
        for name, shape in (
            ("position_m", (count, 3)),
            ("size_m", (count, 3)),
            ("yaw_rad", (count,)),
            ("confidence", (count,)),
            ("T_map_source", (4, 4)),
        ):
            value = np.asarray(getattr(self, name))
            if value.shape != shape:
                check_shape(self, name, value, *shape)
        if isinstance(self.labels, np.ndarray):
            if count and not 0 <= self.labels.min() <= self.labels.max() < len(LABELS):
                raise ValueError(f"labels: {sorted(set(self.labels.tolist()))} are no index of {', '.join(LABELS)}")
        elif not _LABEL_INDEX.keys() >= set(self.labels):
            unknown = sorted(set(self.labels) - _LABEL_INDEX.keys())
            raise ValueError(f"labels: {unknown} not among {', '.join(LABELS)}")

    def records(self) -> np.ndarray:
        """(K,) ``DETECTION``: what the tracker works on."""
        label = self.labels
        if not isinstance(label, np.ndarray):
            label = np.fromiter(map(_LABEL_INDEX.__getitem__, label), np.int64, len(label))
        points = _NO_POINTS if self.points is None else np.ascontiguousarray(self.points, np.int64)
        chances = _NO_CHANCES if self.probabilities is None else np.ascontiguousarray(self.probabilities, np.float64)
        box = np.column_stack((self.position_m, self.size_m, self.yaw_rad)).astype(np.float64)
        confidence, T = (np.ascontiguousarray(a, np.float64) for a in (self.confidence, self.T_map_source))
        made = np.empty(len(box), DETECTION)
        return records_of(box, np.ascontiguousarray(label, np.int64), confidence, points, chances, T, made)


def records_of(
    box: np.ndarray, labels: np.ndarray, confidence: np.ndarray, points: np.ndarray, probabilities: np.ndarray,
    T_map_source: np.ndarray, made: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Write ``made`` (K,) ``DETECTION``, of boxes (K, 7 or more) in a frame that ``T_map_source`` (4, 4) brings to the
    map: centre x, y, z, length, width, height (m), yaw (rad). The rest as in ``Detections``, which also checks it; here
    labels (K,) are indices into ``LABELS``."""
    describe(box, labels, confidence, points, probabilities, T_map_source, made)
    return made


class MultiObjectTracker:
    """Feed it every frame in order; it returns all its tracks, each with its state.

    A detection labelled "background" keeps a track alive, but founds none. Track ids count up and begin at 10 000
    times the second of the day of the first frame, so that they differ after a restart and repeat in a replay.
    """

    def __init__(self, config: TrackingConfig) -> None:
        self._config = config
        self._settings = parameters(config)
        self._blank = _blank(config)
        self._room, self._count = np.zeros(64, TRACK), 0
        self._stamp_ns = 0
        self._next_id = -1
        self._ring_ns = np.zeros(TRAIL, np.int64)  # when the trail's slots were written
        self._frame = 0
        self._cut = config.split_groups and config.boxes == "visible"
        self._source: np.ndarray | None = (
            None  # the detection of the caller that each of the last frame's came from, None = the same
        )
        self.absorbed: dict[int, int] = {}  # tracks that were given up in the last frame, and for which

    @property
    def _tracks(self) -> np.ndarray:
        return self._room[: self._count]

    @property
    def matches(self) -> dict[int, int]:
        """Track id -> index of the detection it took in the last frame; people in one cluster share it."""
        hit = self._tracks[self._tracks["detection"] >= 0]
        taken = hit["detection"] if self._source is None else self._source[hit["detection"]]
        return dict(zip(hit["track_id"].tolist(), taken.tolist(), strict=True))

    def update(self, stamp_ns: int, detections: Detections) -> list[ObjectTrack]:
        """One frame: ``step``, then ``messages``."""
        self.step(stamp_ns, detections.records())
        return self.messages()

    def step(self, stamp_ns: int, seen: np.ndarray) -> None:
        """One frame, seen (K,) ``DETECTION``. A stamp that is not later than the last one begins anew: all tracks are
        dropped."""
        # Bring every track to the time of this frame, cut clusters of people where their tracks are, look who is near
        dt_s, p = self._begin(stamp_ns), self._settings
        seen, source, sure_t, sure_d, contested_t, contested_d, costs = candidates(
            self._tracks, seen, stamp_ns, dt_s, self._cut, p
        )
        self._source = source if len(source) else None

        # Find the cheapest assignment of detections to tracks
        rows, columns = cheapest(costs)

        # Correct the tracks that were seen; confirm, retire, found new ones from what is left, give up doubles
        self._make_room(len(seen))
        self._count, founded, given_up = conclude(
            self._room, self._count, sure_t, sure_d, contested_t, contested_d, costs, rows, columns, seen, dt_s,
            stamp_ns, self._frame % TRAIL, self._ring_ns, self._next_id, self._blank, self._config.absorb, p,
        )  # fmt: skip
        self._next_id += founded
        self.absorbed = dict(given_up.tolist()) if len(given_up) else {}

    def messages(self) -> list[ObjectTrack]:
        """All tracks as of the last frame."""
        return self.told().messages()

    def told(self) -> TrackTable:
        """The same as numbers."""
        return tell(self._tracks, self._stamp_ns, self._config.min_vote)

    def forget(self, vanished: np.ndarray) -> None:
        """Drop the tracks that stand and whose detection of the last frame, (K,) bool, will not be seen again, or that
        had none: what remains of them would look as if it moved. So would the rest of what stands, compared with how
        it was seen until now: that comparison begins anew. Tracks that are kept go on under their ids."""
        tracks = self._tracks
        of_each = vanished if self._source is None else vanished[self._source]
        gone = np.append(of_each, True)[tracks["detection"]]  # the last one is for no detection
        self._count = keep(self._room, tracks["moving"] | (~gone & tracks["confirmed"]))
        standing = ~self._tracks["moving"]
        self._tracks["frames"][standing], self._tracks["run"][standing] = 0, 0

    def _begin(self, stamp_ns: int) -> float:
        if self._next_id < 0:
            self._next_id = (stamp_ns // 1_000_000_000 % 86_400) * 10_000 + self._config.first_id
        if stamp_ns <= self._stamp_ns:
            self._count = 0
        dt_s = (stamp_ns - self._stamp_ns) * 1e-9
        self._stamp_ns = stamp_ns
        self._frame += 1
        self._ring_ns[self._frame % TRAIL] = stamp_ns
        return dt_s

    def _make_room(self, more: int) -> None:
        if self._count + more > len(self._room):
            self._room = np.concatenate((self._tracks, np.zeros(self._count + 2 * more, TRACK)))


def _blank(c: TrackingConfig) -> np.ndarray:
    """(1,) ``TRACK``: a track of which nothing is known but how uncertain the first sight of it is."""
    plane, height = c.birth_sigma_m or c.position_sigma_m, c.birth_sigma_m or c.height_sigma_m
    sigma = [plane, plane, height, c.velocity_sigma_mps, c.velocity_sigma_mps, c.climb_sigma_mps]
    blank = np.zeros(1, TRACK)
    blank["cov"] = np.diag(np.square(sigma))
    return blank
