"""The tracks as others see them: a table of arrays, and the messages made from it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

from common.messages import ObjectTrack
from services.infra_lidar.classification.classes import LABELS, UNKNOWN

_STATES: tuple[Literal["tentative", "confirmed", "coasting"], ...] = ("tentative", "confirmed", "coasting")


@dataclass(frozen=True)
class TrackTable:
    """N tracks of one frame, map frame.

    track_id, label (index into ``LABELS``), state (0 tentative, 1 confirmed, 2 coasting), points: (N,) int64.
    label_confidence: (N,) share of the votes. position_m, velocity_mps, size_m: (N, 3). yaw_rad, age_s, score: (N,).
    covariance: (N, 6, 6) of position and velocity.
    """

    track_id: np.ndarray
    label: np.ndarray
    label_confidence: np.ndarray
    position_m: np.ndarray
    velocity_mps: np.ndarray
    covariance: np.ndarray
    size_m: np.ndarray
    yaw_rad: np.ndarray
    age_s: np.ndarray
    score: np.ndarray
    state: np.ndarray
    points: np.ndarray

    def without(self, label: int) -> TrackTable:
        """The tracks of every other class than ``label``, index into ``LABELS``."""
        kept = self.label != label
        return TrackTable(*(getattr(self, column.name)[kept] for column in fields(self)))

    def messages(self) -> list[ObjectTrack]:
        """One message for each track."""
        columns = (getattr(self, column.name).tolist() for column in fields(self))
        return [
            ObjectTrack(
                track_id=track_id, label=LABELS[label], label_confidence=share, position_m=(x, y, z),
                velocity_mps=(vx, vy, vz), covariance=covariance, size_m=(length, width, height), yaw_rad=yaw,
                age_s=age, score=score, state=_STATES[state], points=points,
            )
            for track_id, label, share, (x, y, z), (vx, vy, vz), covariance, (length, width, height), yaw, age, score,
                state, points in zip(*columns, strict=True)
        ]  # fmt: skip


def report(tracks: np.ndarray, stamp_ns: int, min_vote: float) -> TrackTable:
    """The tracks (N,) ``TRACK`` at ``stamp_ns``. A class with less than ``min_vote`` of the votes is "unknown"."""
    hit = tracks["detection"] >= 0
    share = _label_share(tracks)
    return TrackTable(
        track_id=tracks["track_id"].copy(),
        label=np.where(share >= min_vote, tracks["label"], UNKNOWN),
        label_confidence=share,
        position_m=tracks["mean"][:, :3].copy(),
        velocity_mps=np.where(tracks["moving"][:, None], tracks["mean"][:, 3:], 0.0),
        covariance=tracks["cov"].copy(),
        size_m=tracks["size"].copy(),
        yaw_rad=tracks["yaw"].copy(),
        age_s=1e-9 * (stamp_ns - tracks["born_ns"]),
        score=tracks["score"].copy(),
        state=np.where(tracks["confirmed"], np.where(hit, 1, 2), 0),
        points=np.where(hit, tracks["points"], 0),
    )


def _label_share(tracks: np.ndarray) -> np.ndarray:
    """(N,) share of the votes for a track's class, 0..1."""
    votes = np.take_along_axis(tracks["votes"], tracks["label"][:, None], axis=1)[:, 0]
    return np.asarray(np.minimum(votes / tracks["vote_weight"], 1.0))
