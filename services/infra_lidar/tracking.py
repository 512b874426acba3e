"""Multi-object tracking of labelled boxes: predict, associate, update, judge, retire, found.

Stacked constant-velocity Kalman filters (``tracking_filter``), Mahalanobis gate and Hungarian assignment with a soft
class term (``tracking_assign``), edge-aware box measurements, size, heading and the test that decides whether a track
moves at all (``tracking_shape``). Lifetimes are seconds, not frames. No clock, no I/O: the time is ``stamp_ns``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import get_args

import numpy as np

from common.messages import ObjectLabel, ObjectTrack, check_shape
from services.infra_lidar.classes import BACKGROUND, CLASSES, LABELS, UNKNOWN
from services.infra_lidar.config import TrackingConfig
from services.infra_lidar.tracking_assign import associate, pair_costs
from services.infra_lidar.tracking_filter import TRACK, TRAIL, predict
from services.infra_lidar.tracking_shape import judge_movement, note_places, pieces_of_known, update_pairs

assert set(LABELS) == set(get_args(ObjectLabel))

_DRIFT_NS = 200_000_000  # for so long a lost track goes on with what is known of its velocity, moving or not


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

    def class_chances(self) -> np.ndarray:
        """(K, C) probabilities: as given, or the confidence on the label and the rest spread over the others."""
        if self.probabilities is not None:
            return np.ascontiguousarray(self.probabilities, np.float64)
        index = np.array([LABELS.index(label) for label in self.labels], np.int64)
        known = index < len(CLASSES)
        share = np.clip(np.asarray(self.confidence, np.float64), 0.0, 1.0)
        chances = np.repeat((1.0 - share[:, None]) / (len(CLASSES) - 1), len(CLASSES), axis=1)
        chances[np.flatnonzero(known), index[known]] = share[known]
        chances[~known] = 1.0 / len(CLASSES)
        return chances


class MultiObjectTracker:
    """Feed it every frame in order; it returns all its tracks, each with its state.

    A detection labelled "background" keeps a track alive, but founds none. Track ids count up and begin at 10 000
    times the second of the day of the first frame, so that they differ after a restart and repeat in a replay.
    """

    def __init__(self, config: TrackingConfig) -> None:
        self._config = config
        self._tracks = np.zeros(0, TRACK)
        self._stamp_ns = 0
        self._next_id = -1
        self._ring_ns = np.zeros(TRAIL, np.int64)  # when the trail's slots were written
        self._frame = 0

    @property
    def matches(self) -> dict[int, int]:
        """Track id -> index of the detection it took in the last frame."""
        hit = self._tracks[self._tracks["detection"] >= 0]
        return dict(zip(hit["track_id"].tolist(), hit["detection"].tolist(), strict=True))

    def update(self, stamp_ns: int, detections: Detections) -> list[ObjectTrack]:
        """One frame. A stamp that is not later than the last one begins anew: all tracks are dropped."""
        # Bring every track to the time of this frame
        self._advance(stamp_ns)

        # Find the cheapest assignment of detections to tracks
        position, size, yaw = _boxes(detections)
        chances = detections.class_chances()
        rows, columns = associate(self._costs(position, size, yaw, chances))

        # Correct the tracks that were seen, and decide which of all move
        points = _points(detections)
        self._correct(np.column_stack((rows, columns)), position, size, yaw, chances, points)
        self._judge(np.asarray(detections.confidence, np.float64))

        # Retire, then found new tracks from what is left
        self._retire()
        self._found(detections, np.setdiff1d(np.arange(len(position)), columns), position, size, yaw, chances, points)
        return self._report()

    def _advance(self, stamp_ns: int) -> None:
        if self._next_id < 0:
            self._next_id = (stamp_ns // 1_000_000_000 % 86_400) * 10_000 + self._config.first_id
        if stamp_ns <= self._stamp_ns:
            self._tracks = self._tracks[:0]
        self._dt_s = (stamp_ns - self._stamp_ns) * 1e-9
        self._stamp_ns = stamp_ns
        self._frame += 1
        self._ring_ns[self._frame % TRAIL] = stamp_ns
        self._stop_standing()
        self._tracks["detection"] = -1
        predict(self._tracks, self._dt_s, self._config.acceleration_sigma)

    def _stop_standing(self) -> None:
        """What stood as far as anybody can tell, and is lost, does not drift on with the noise of its velocity."""
        t = self._tracks
        lost = self._stamp_ns - t["seen_ns"] > _DRIFT_NS
        t["mean"][lost & ~t["moving"], 3:] = 0.0

    def _costs(self, position: np.ndarray, size: np.ndarray, yaw: np.ndarray, chances: np.ndarray) -> np.ndarray:
        c = self._config
        return np.asarray(
            pair_costs(
                self._tracks, position, size, yaw, chances,
                c.position_sigma_m, c.height_sigma_m, c.gate, c.class_weight, c.boxes == "visible",
            )
        )  # fmt: skip

    def _correct(
        self, pairs: np.ndarray, position: np.ndarray, size: np.ndarray, yaw: np.ndarray, chances: np.ndarray,
        points: np.ndarray,
    ) -> None:  # fmt: skip
        c = self._config
        update_pairs(
            self._tracks, pairs, position, size, yaw, chances, points, c.position_sigma_m, c.height_sigma_m,
            c.boxes == "visible", c.size_gain, c.yaw_gain, math.exp(-self._dt_s / c.vote_s), self._stamp_ns,
        )  # fmt: skip

    def _judge(self, confidence: np.ndarray) -> None:
        c, tracks = self._config, self._tracks
        within = self._stamp_ns - self._ring_ns <= c.movement_s * 1e9
        judge_movement(tracks, self._frame % TRAIL, int(within.sum()), c.movement_m)
        share = 1.0 - math.exp(-self._dt_s / c.score_s)
        hit = tracks["detection"] >= 0
        target = np.zeros(len(tracks))
        target[hit] = np.clip(confidence[tracks["detection"][hit]], 0.0, 1.0)
        tracks["score"] += share * (target - tracks["score"])
        age_s = (self._stamp_ns - tracks["born_ns"]) * 1e-9
        tracks["confirmed"] |= (tracks["hits"] >= c.confirm_hits) & (age_s >= c.confirm_s - 1e-6)

    def _retire(self) -> None:
        c = self._config
        unseen_ns = self._stamp_ns - self._tracks["seen_ns"]
        known_ns = self._tracks["seen_ns"] - self._tracks["born_ns"]
        # Nobody waits for long for what was seen for a moment only.
        gap_ns, coast_ns = round(c.tentative_gap_s * 1e9), np.minimum(round(c.coast_s * 1e9), known_ns)
        allowed_ns = np.where(self._tracks["confirmed"], np.maximum(coast_ns, gap_ns), gap_ns)
        if np.any(unseen_ns > allowed_ns):
            self._tracks = self._tracks[unseen_ns <= allowed_ns]

    def _found(
        self, detections: Detections, free: np.ndarray, position: np.ndarray, size: np.ndarray, yaw: np.ndarray,
        chances: np.ndarray, points: np.ndarray,
    ) -> None:  # fmt: skip
        c = self._config
        free = np.array([d for d in free if detections.labels[d] != CLASSES[BACKGROUND]], np.int64)
        if c.boxes == "visible" and len(free):
            free = free[~pieces_of_known(self._tracks, position[free], size[free], chances[free])]
        if not len(free):
            return
        new = np.zeros(len(free), TRACK)
        new["track_id"] = self._next_id + np.arange(len(free))
        self._next_id += len(free)
        new["mean"][:, :3], new["size"], new["yaw"] = position[free], size[free], yaw[free]
        plane, height, speed = c.position_sigma_m**2, c.height_sigma_m**2, c.velocity_sigma_mps**2
        new["cov"] = np.diag([plane, plane, height, speed, speed, 1.0])
        new["votes"], new["points"], new["detection"] = chances[free], points[free], free
        new["born_ns"] = new["seen_ns"] = self._stamp_ns
        new["hits"], new["run"], new["frames"], new["presence"] = 1, 1, 1, 1.0
        new["confirmed"] = c.confirm_hits <= 1 and c.confirm_s <= 0.0
        note_places(new, self._frame % TRAIL)
        new["score"] = np.clip(np.asarray(detections.confidence, np.float64)[free], 0.0, 1.0) * 0.5
        self._tracks = np.concatenate((self._tracks, new))

    def _report(self) -> list[ObjectTrack]:
        tracks = self._tracks
        votes = tracks["votes"] / np.maximum(tracks["votes"].sum(axis=1, keepdims=True), 1e-12)
        best = np.where(votes.max(axis=1, initial=0.0) < self._config.min_vote, UNKNOWN, votes.argmax(axis=1))
        velocity = np.where(tracks["moving"][:, None], tracks["mean"][:, 3:], 0.0)
        coasting = tracks["detection"] < 0
        columns = zip(
            tracks["track_id"].tolist(), best.tolist(), votes.max(axis=1, initial=0.0).tolist(),
            _triples(tracks["mean"][:, :3]), _triples(velocity), tracks["cov"].tolist(), _triples(tracks["size"]),
            tracks["yaw"].tolist(), ((self._stamp_ns - tracks["born_ns"]) * 1e-9).tolist(),
            tracks["score"].tolist(), tracks["confirmed"].tolist(), coasting.tolist(), tracks["points"].tolist(),
            strict=True,
        )  # fmt: skip
        return [
            ObjectTrack(
                track_id=track_id, label=LABELS[label], label_confidence=min(share, 1.0), position_m=place,
                velocity_mps=speed, covariance=cov, size_m=size, yaw_rad=yaw, age_s=age, score=score,
                state=("coasting" if lost else "confirmed") if confirmed else "tentative", points=0 if lost else seen,
            )
            for track_id, label, share, place, speed, cov, size, yaw, age, score, confirmed, lost, seen in columns
        ]  # fmt: skip


def _triples(rows: np.ndarray) -> list[tuple[float, float, float]]:
    """(N, 3) as N tuples."""
    return list(zip(rows[:, 0].tolist(), rows[:, 1].tolist(), rows[:, 2].tolist(), strict=True))


def _boxes(detections: Detections) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, size and yaw as contiguous float64."""
    return (
        np.ascontiguousarray(detections.position_m, np.float64),
        np.ascontiguousarray(detections.size_m, np.float64),
        np.ascontiguousarray(detections.yaw_rad, np.float64),
    )


def _points(detections: Detections) -> np.ndarray:
    if detections.points is None:
        return np.zeros(len(detections.labels), np.int64)
    return np.ascontiguousarray(detections.points, np.int64)
