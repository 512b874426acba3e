"""Multi-object tracking of labelled boxes: predict, associate, update, judge, retire, found.

Stacked constant-velocity Kalman filters (``tracking_filter``), Mahalanobis gate and Hungarian assignment with a soft
class term (``tracking_assign``), edge-aware box measurements, size, heading and the test that decides whether a track
moves at all (``tracking_shape``). Lifetimes are seconds, not frames. No clock, no I/O: the time is ``stamp_ns``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import get_args

import numpy as np

from common.messages import ObjectLabel, ObjectTrack, check_shape
from services.infra_lidar.classes import CLASSES, LABELS
from services.infra_lidar.tracking_assign import allowed_pairs, associate
from services.infra_lidar.tracking_config import TrackingConfig
from services.infra_lidar.tracking_filter import DETECTION, TRACK, TRAIL, parameters, predict
from services.infra_lidar.tracking_life import begin_frame, found, judge_lives, messages
from services.infra_lidar.tracking_overlap import absorb_doubles, founders
from services.infra_lidar.tracking_shape import judge_movement, update_pairs
from services.infra_lidar.tracking_split import cut_groups

assert set(LABELS) == set(get_args(ObjectLabel))

_LABEL_INDEX: dict[str, int] = {label: index for index, label in enumerate(LABELS)}


@dataclass(frozen=True)
class Detections:
    """K boxes of one frame, metres and radians, map frame.

    ``position_m`` (K, 3) centre, ``size_m`` (K, 3) length, width, height, ``yaw_rad`` (K,), ``labels`` (K,) of
    ``LABELS``, ``confidence`` (K,) in 0..1, ``points`` (K,) or None, ``probabilities`` (K, C) over ``CLASSES`` or
    None (then they follow from label and confidence).
    """

    position_m: np.ndarray
    size_m: np.ndarray
    yaw_rad: np.ndarray
    labels: Sequence[str]
    confidence: np.ndarray
    points: np.ndarray | None = None
    probabilities: np.ndarray | None = None

    def __post_init__(self) -> None:
        count = len(self.labels)
        check_shape(self, "position_m", np.asarray(self.position_m), count, 3)
        check_shape(self, "size_m", np.asarray(self.size_m), count, 3)
        check_shape(self, "yaw_rad", np.asarray(self.yaw_rad), count)
        check_shape(self, "confidence", np.asarray(self.confidence), count)
        unknown = sorted(set(self.labels) - set(LABELS))
        if unknown:
            raise ValueError(f"labels: {unknown} not among {', '.join(LABELS)}")

    def records(self) -> np.ndarray:
        """(K,) ``DETECTION``: what the kernels work on."""
        made = np.empty(len(self.labels), DETECTION)
        made["position"], made["size"], made["yaw"] = self.position_m, self.size_m, self.yaw_rad
        made["label"] = list(map(_LABEL_INDEX.__getitem__, self.labels))
        made["confidence"] = np.minimum(np.maximum(self.confidence, 0.0), 1.0)
        made["points"] = 0 if self.points is None else self.points
        made["chances"] = _chances(made) if self.probabilities is None else self.probabilities
        return made


def _chances(made: np.ndarray) -> np.ndarray:
    """(K, C) probabilities: the confidence on the label and the rest spread over the others; unknown is evenly so."""
    count, known = len(CLASSES), made["label"] < len(CLASSES)
    share = np.where(known, made["confidence"], 1.0 / count)
    chances = np.empty((len(made), count))
    chances[:] = ((1.0 - share) / (count - 1))[:, None]
    chances[np.arange(len(made)), np.minimum(made["label"], count - 1)] = share
    return chances


class MultiObjectTracker:
    """Feed it every frame in order; it returns all its tracks, each with its state.

    A detection labelled "background" keeps a track alive, but founds none. Track ids count up and begin at 10 000
    times the second of the day of the first frame, so that they differ after a restart and repeat in a replay.
    """

    def __init__(self, config: TrackingConfig) -> None:
        self._config = config
        self._settings = parameters(config)
        self._new_cov = _covariance_of_new(config)
        self._tracks = np.zeros(0, TRACK)
        self._stamp_ns = 0
        self._next_id = -1
        self._ring_ns = np.zeros(TRAIL, np.int64)  # when the trail's slots were written
        self._frame = 0
        self._cut = config.split_groups and config.boxes == "visible"
        self._source = np.zeros(0, np.int64)  # the detection of the caller that each of the last frame's came from
        self.absorbed: dict[int, int] = {}  # tracks that were given up in the last frame, and for which

    @property
    def matches(self) -> dict[int, int]:
        """Track id -> index of the detection it took in the last frame; people in one cluster share it."""
        hit = self._tracks[self._tracks["detection"] >= 0]
        return dict(zip(hit["track_id"].tolist(), self._source[hit["detection"]].tolist(), strict=True))

    def update(self, stamp_ns: int, detections: Detections) -> list[ObjectTrack]:
        """One frame: ``step``, then ``messages``."""
        self.step(stamp_ns, detections)
        return self.messages()

    def step(self, stamp_ns: int, detections: Detections) -> None:
        """One frame. A stamp that is not later than the last one begins anew: all tracks are dropped."""
        # Bring every track to the time of this frame
        dt_s, seen, p = self._advance(stamp_ns), detections.records(), self._settings

        # Cut clusters of people where their tracks are
        seen, self._source = cut_groups(self._tracks, seen) if self._cut else (seen, np.arange(len(seen)))

        # Find the cheapest assignment of detections to tracks
        rows, columns, costs = allowed_pairs(self._tracks, seen, p)
        rows, columns = associate(rows, columns, costs, len(self._tracks), len(seen))

        # Correct the tracks that were seen, and decide which of all move
        update_pairs(self._tracks, rows, columns, seen, dt_s, stamp_ns, p)
        judge_movement(self._tracks, self._frame % TRAIL, self._frames_back(), p)

        # Confirm, retire, then found new tracks from what is left
        self._keep(judge_lives(self._tracks, seen, dt_s, stamp_ns, p))
        self._found(seen, founders(self._tracks, seen, columns, p))
        self._absorb()

    def messages(self) -> list[ObjectTrack]:
        """All tracks as of the last frame."""
        return messages(self._tracks, self._stamp_ns, self._config.min_vote)

    def forget(self, vanished: np.ndarray) -> None:
        """Drop the tracks that stand and whose detection of the last frame, (K,) bool, will not be seen again, or that
        had none: what remains of them would look as if it moved. So would the rest of what stands, compared with how
        it was seen until now: that comparison begins anew. Tracks that are kept go on under their ids."""
        gone = np.append(vanished[self._source], True)[self._tracks["detection"]]  # the last one is for no detection
        self._keep(self._tracks["moving"] | (~gone & self._tracks["confirmed"]))
        standing = ~self._tracks["moving"]
        self._tracks["frames"][standing], self._tracks["run"][standing] = 0, 0

    def _advance(self, stamp_ns: int) -> float:
        if self._next_id < 0:
            self._next_id = (stamp_ns // 1_000_000_000 % 86_400) * 10_000 + self._config.first_id
        if stamp_ns <= self._stamp_ns:
            self._tracks = self._tracks[:0]
        dt_s = (stamp_ns - self._stamp_ns) * 1e-9
        self._stamp_ns = stamp_ns
        self._frame += 1
        self._ring_ns[self._frame % TRAIL] = stamp_ns
        begin_frame(self._tracks, stamp_ns)
        predict(self._tracks, dt_s, self._settings)
        return dt_s

    def _frames_back(self) -> int:
        """How many of the last frames lie within ``movement_s``."""
        return int(np.count_nonzero(self._stamp_ns - self._ring_ns <= self._config.movement_s * 1e9))

    def _keep(self, alive: np.ndarray) -> None:
        if not alive.all():
            self._tracks = self._tracks[alive]

    def _absorb(self) -> None:
        """One road user, one track."""
        if not self._config.absorb:
            return
        into = absorb_doubles(self._tracks)
        lost = np.flatnonzero(into >= 0)
        ids = self._tracks["track_id"]
        self.absorbed = dict(zip(ids[lost].tolist(), ids[into[lost]].tolist(), strict=True))
        self._keep(into < 0)

    def _found(self, seen: np.ndarray, which: np.ndarray) -> None:
        if len(which):
            slot = self._frame % TRAIL
            new = found(seen, which, self._next_id, self._stamp_ns, slot, self._new_cov, self._settings)
            self._next_id += len(which)
            self._tracks = np.concatenate((self._tracks, new))


def _covariance_of_new(c: TrackingConfig) -> np.ndarray:
    plane, height = c.birth_sigma_m or c.position_sigma_m, c.birth_sigma_m or c.height_sigma_m
    sigma = [plane, plane, height, c.velocity_sigma_mps, c.velocity_sigma_mps, c.climb_sigma_mps]
    return np.diag(np.square(sigma))
