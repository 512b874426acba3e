"""Labels from a recording without labels: who drove or walked through is a road user, what never moved is none. Pure.

A track that has moved far, lived long and was mostly called one class is of that class in all of its moments, the hard
ones included, in which the forest was unsure or wrong. A cluster where something stands in nearly all pictures, and
that no moving track has, is clutter. What looks like a parked car or a waiting person is neither.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from services.infra_lidar.adaptation.recorder import SiteRecord, TrackStory
from services.infra_lidar.classification.classes import BACKGROUND, CLASSES

MOVED_M, LIVED_S, MIN_HITS = 8.0, 1.5, 10
MOVING_SHARE = 0.5  # of its revolutions in which a track moved
AGREED_SHARE = 0.7  # of the votes for road users that one class must have
STOOD_M = 1.0  # a track that seemed to move, but no farther, stands
STANDING = 0.7  # share of a cluster's points that lie where something always is
STANDING_S = 30.0  # shorter recordings do not tell what stands from what waits
PLACE_M = 2.0  # clusters nearer than about that show one thing
_SMALL = [CLASSES.index(name) for name in ("car", "cyclist", "pedestrian")]
_PARKED_M = (6.0, 2.4, 2.3)  # length, width and height that a parked car or a waiting person does not exceed


class SiteLabels(NamedTuple):
    """n clusters of a ``SiteRecord``: their rows (n,), labels (n,) index into ``CLASSES`` and groups (n,): clusters of
    one group show one road user, or one place."""

    rows: np.ndarray
    labels: np.ndarray
    groups: np.ndarray


def class_of(track: TrackStory) -> int | None:
    """The class of a track that can be trusted; None of the others.

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
    """The clusters of a recording that label themselves."""
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
    """(K,) bool: stands where something always is, is of no track that moved, and is not like a parked car."""
    if (record.pictures[-1] - record.pictures[0]) * 1e-9 < STANDING_S:
        return np.zeros(len(record.track), bool)
    strolled = [number for number, track in record.tracks.items() if track.moving_frames and track.moved_m > STOOD_M]
    stands = (record.standing >= STANDING) & ~np.isin(record.track, strolled) & (record.track != -2)
    return np.asarray(stands & ~_may_be_parked(record, stands))


def _may_be_parked(record: SiteRecord, stands: np.ndarray) -> np.ndarray:
    """(K,) bool: at places where most of what stands has the size of a car or a person and is called one."""
    size = record.box[:, 3:6]
    small = np.all(size <= _PARKED_M, axis=1) & np.isin(record.called.argmax(axis=1), _SMALL)
    _, place = np.unique(np.round(record.box[:, :2] / PLACE_M).astype(np.int64), axis=0, return_inverse=True)
    place = place.ravel()
    alike = np.bincount(place, small & stands) > 0.5 * np.bincount(place, stands)
    return np.asarray(alike[place])
