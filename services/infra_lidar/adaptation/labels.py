"""Labels from an unlabelled recording: tracks that passed through are road users, static clusters are background. Pure.

A track that moved far, lived long and was mostly classified as one class gets that class in all of its revolutions,
also in those where the forest was unsure or wrong. A cluster in cells that are occupied in nearly all revolutions, and
that belongs to no moving track, is clutter. What looks like a parked car or a waiting person gets no label.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from services.infra_lidar.adaptation.recorder import SiteRecord, TrackHistory
from services.infra_lidar.classification.classes import BACKGROUND, CLASSES

MOVED_M, LIVED_S, MIN_HITS = 8.0, 1.5, 10
MOVING_SHARE = 0.5  # least share of its revolutions in which a track moved
AGREED_SHARE = 0.7  # least share of the votes for road users that one class must have
STOOD_M = 1.0  # a track that moved no farther than this counts as standing
STANDING = 0.7  # least share of a cluster's points that lie in always-occupied cells
STANDING_S = 30.0  # in shorter recordings static and waiting objects cannot be distinguished
PLACE_M = 2.0  # clusters closer together than this show the same object
_SMALL = [CLASSES.index(name) for name in ("car", "cyclist", "pedestrian")]
_PARKED_M = (6.0, 2.4, 2.3)  # length, width and height that a parked car or a waiting person does not exceed


class SiteLabels(NamedTuple):
    """n clusters of a ``SiteRecord``: their rows (n,), labels (n,) index into ``CLASSES`` and groups (n,): clusters of
    one group show one road user, or one place."""

    rows: np.ndarray
    labels: np.ndarray
    groups: np.ndarray


def class_of(track: TrackHistory) -> int | None:
    """The class of a track that fulfils all conditions above; None for others.

    Background does not move: its votes do not count for or against a class.
    """
    lived_s = (track.seen_ns - track.born_ns) * 1e-9
    if track.moved_m < MOVED_M or lived_s < LIVED_S or track.hits < MIN_HITS:
        return None
    if track.moving_frames < MOVING_SHARE * track.frames:
        return None
    votes = track.votes.copy()
    votes[BACKGROUND] = 0.0
    best = int(votes.argmax())
    return best if votes[best] >= AGREED_SHARE * votes.sum() > 0.0 else None


def label_site(record: SiteRecord) -> SiteLabels:
    """Labels for the clusters of a recording that can be labelled by these rules."""
    trusted = {number: found for number, track in record.tracks.items() if (found := class_of(track)) is not None}
    labels = np.full(len(record.track), -1, np.int64)
    groups = np.full(len(record.track), -1, np.int64)
    for group, (number, found) in enumerate(trusted.items()):
        mine = record.track == number
        labels[mine], groups[mine] = found, group
    clutter = _clutter(record) & (labels < 0)
    place = np.round(record.box[clutter, :2] / PLACE_M).astype(np.int64)
    _, which = np.unique(place, axis=0, return_inverse=True)
    labels[clutter], groups[clutter] = BACKGROUND, len(trusted) + which.ravel()
    rows = np.flatnonzero(labels >= 0)
    return SiteLabels(rows, labels[rows], groups[rows])


def _clutter(record: SiteRecord) -> np.ndarray:
    """(K,) bool: in always-occupied cells, of no track that moved, and not like a parked car."""
    if (record.sampled_ns[-1] - record.sampled_ns[0]) * 1e-9 < STANDING_S:
        return np.zeros(len(record.track), bool)
    moved = [number for number, track in record.tracks.items() if track.moving_frames and track.moved_m > STOOD_M]
    stands = (record.standing >= STANDING) & ~np.isin(record.track, moved) & (record.track != -2)
    return np.asarray(stands & ~_may_be_parked(record, stands))


def _may_be_parked(record: SiteRecord, stands: np.ndarray) -> np.ndarray:
    """(K,) bool: at places where most static clusters have the size and the class of a car or a person."""
    size = record.box[:, 3:6]
    small = np.all(size <= _PARKED_M, axis=1) & np.isin(record.called.argmax(axis=1), _SMALL)
    _, place = np.unique(np.round(record.box[:, :2] / PLACE_M).astype(np.int64), axis=0, return_inverse=True)
    place = place.ravel()
    alike = np.bincount(place, small & stands) > 0.5 * np.bincount(place, stands)
    return np.asarray(alike[place])
