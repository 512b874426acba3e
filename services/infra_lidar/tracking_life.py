"""A track's life: founded, scored, confirmed, given up, and told to others."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from common.messages import ObjectTrack
from services.infra_lidar.classes import LABELS, UNKNOWN
from services.infra_lidar.jit import inner, kernel
from services.infra_lidar.tracking_shape import note_place, strength, vote

_DRIFT_NS = 200_000_000  # for so long a lost track goes on with what is known of its velocity, moving or not
_STATES: tuple[Literal["tentative", "confirmed", "coasting"], ...] = ("tentative", "confirmed", "coasting")


@inner
def begin_frame(tracks: np.ndarray, stamp_ns: int) -> None:
    """No track has a detection yet. What stood as far as anybody can tell, and is lost, does not drift on with the
    noise of its velocity."""
    for t in range(len(tracks)):
        track = tracks[t]
        track.detection = -1
        if not track.moving and stamp_ns - track.seen_ns > _DRIFT_NS:
            for k in range(3, 6):
                track.mean[k] = 0.0


@inner
def judge_lives(tracks: np.ndarray, detections: np.ndarray, dt_s: float, stamp_ns: int, p: Any) -> np.ndarray:
    """Score and confirm every track, in place; (N,) bool: which of them live on.

    Nobody waits for long for what was seen for a moment only.
    """
    share = 1.0 - math.exp(-dt_s / p.score_s)
    alive = np.ones(len(tracks), np.bool_)
    for t in range(len(tracks)):
        track = tracks[t]
        target = detections[track.detection].confidence if track.detection >= 0 else 0.0
        track.score += share * (target - track.score)
        if track.hits >= p.confirm_hits and 1e-9 * (stamp_ns - track.born_ns) >= p.confirm_s - 1e-6:
            track.confirmed = True
        unseen_s, allowed_s = 1e-9 * (stamp_ns - track.seen_ns), p.tentative_gap_s
        if track.confirmed:
            known_s = 1e-9 * (track.seen_ns - track.born_ns)
            allowed_s = max(min(p.coast_s, known_s) if p.coast_as_known else p.coast_s, allowed_s)
        alive[t] = unseen_s <= allowed_s + 1e-6
    return alive


@inner
def found(
    new: np.ndarray, detections: np.ndarray, founders: np.ndarray, first_id: int, stamp_ns: int, slot: int, p: Any
) -> None:
    """Fill ``new`` (N,) ``TRACK``, blank ones, one for each of the detections ``founders`` (N,)."""
    for i in range(len(founders)):
        track, seen = new[i], detections[founders[i]]
        track.track_id = first_id + i
        for k in range(3):  # spelled out: whole-array assignments take the compiler seconds
            track.mean[k], track.size[k] = seen.position[k], seen.size[k]
        track.yaw = seen.yaw
        track.label = seen.label
        vote(track, seen, 1.0, p)
        track.born_ns = track.seen_ns = stamp_ns
        track.hits, track.run, track.frames, track.presence = 1, 1, 1, 1.0
        track.confirmed = p.confirm_hits <= 1 and p.confirm_s <= 0.0
        track.moving = p.movement_m == 0.0
        track.score = 0.5 * seen.confidence
        track.points = seen.points
        track.detection = founders[i]
        note_place(track, slot)


@kernel
def _describe(
    tracks: np.ndarray, stamp_ns: int, min_vote: float, numbers: np.ndarray, counts: np.ndarray, covariance: np.ndarray
) -> None:
    """``numbers`` (13, N): position, velocity, size, yaw, age, score, share of the votes; ``counts`` (4, N): id,
    label, state, points."""
    for t in range(len(tracks)):
        track = tracks[t]
        for i in range(3):
            numbers[i, t] = track.mean[i]
            numbers[3 + i, t] = track.mean[3 + i] if track.moving else 0.0
            numbers[6 + i, t] = track.size[i]
        share, lost = strength(track, track.label), track.detection < 0
        numbers[9, t], numbers[10, t] = track.yaw, 1e-9 * (stamp_ns - track.born_ns)
        numbers[11, t], numbers[12, t] = track.score, share
        counts[0, t], counts[1, t] = track.track_id, track.label if share >= min_vote else UNKNOWN
        counts[2, t] = (2 if lost else 1) if track.confirmed else 0
        counts[3, t] = 0 if lost else track.points
        for i in range(6):
            for j in range(6):
                covariance[t, i, j] = track.cov[i, j]


@dataclass(frozen=True)
class TrackTable:
    """N tracks as of a frame: ``numbers`` (13, N) and ``counts`` (4, N) as ``_describe`` writes them, ``covariance``
    (N, 6, 6) of position and velocity."""

    numbers: np.ndarray
    counts: np.ndarray
    covariance: np.ndarray

    def without(self, label: int) -> TrackTable:
        """Those that are not taken for ``label``, index into ``LABELS``."""
        kept = self.counts[1] != label
        return TrackTable(self.numbers[:, kept], self.counts[:, kept], self.covariance[kept])

    def messages(self) -> list[ObjectTrack]:
        """What others are told: one message a track, in their order."""
        x, y, z, vx, vy, vz, length, width, height, yaws, ages, scores, shares = self.numbers.tolist()
        ids, labels, states, points = self.counts.tolist()
        columns = zip(
            ids, labels, shares, zip(x, y, z, strict=True), zip(vx, vy, vz, strict=True), self.covariance.tolist(),
            zip(length, width, height, strict=True), yaws, ages, scores, states, points, strict=True,
        )  # fmt: skip
        return [
            ObjectTrack(
                track_id=track_id, label=LABELS[label], label_confidence=share, position_m=place, velocity_mps=speed,
                covariance=cov, size_m=size, yaw_rad=yaw, age_s=age, score=score, state=_STATES[state], points=seen,
            )
            for track_id, label, share, place, speed, cov, size, yaw, age, score, state, seen in columns
        ]  # fmt: skip


def tell(tracks: np.ndarray, stamp_ns: int, min_vote: float) -> TrackTable:
    """The tracks at ``stamp_ns``; one whose class has less than ``min_vote`` of the votes is unknown."""
    n = len(tracks)
    numbers, counts, covariance = np.empty((13, n)), np.empty((4, n), np.int64), np.empty((n, 6, 6))
    _describe(tracks, stamp_ns, min_vote, numbers, counts, covariance)
    return TrackTable(numbers, counts, covariance)
