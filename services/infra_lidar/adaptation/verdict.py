"""Compares the site's forest with the one in use, on data that it was not trained on. Pure."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from services.infra_lidar.classification.classes import BACKGROUND, CLASSES, UNKNOWN
from services.infra_lidar.classification.classifier import likeliest
from services.infra_lidar.classification.forest import Forest

MIN_USERS = 8  # held-out road users; fewer are too few for a comparison
GAIN = 0.02  # least gain, of road users classified correctly or of false ones per revolution
LOSS = 0.01  # of road users classified correctly at the site, that may be lost
FORGOTTEN = 0.02  # of each class on generated streets, that may be lost


class Figures(NamedTuple):
    """Figures of a forest. right: share of the held-out clusters of road users classified correctly, each road user
    counting once. false: clutter classified as road user, per revolution. recall: (C,) share of each class classified
    correctly on generated streets, NaN where there are none."""

    right: float
    false: float
    recall: np.ndarray


class HeldOut(NamedTuple):
    """Clusters of the last part of a recording: x (K, F), labels, groups (K,), and the number of revolutions."""

    x: np.ndarray
    labels: np.ndarray
    groups: np.ndarray
    revolutions: int

    @property
    def users(self) -> int:
        """Number of road users."""
        return len(np.unique(self.groups[self.labels != BACKGROUND]))


def called(forest: Forest, x: np.ndarray, names: tuple[str, ...], min_confidence: float) -> np.ndarray:
    """(K,) index into ``LABELS``: the service's class of clusters with features (K, F), columns ``names``."""
    probabilities = forest.class_probabilities(x[:, [names.index(name) for name in forest.features]])
    return likeliest(probabilities, min_confidence)[0]


def judge(said: np.ndarray, held_out: HeldOut, said_unseen: np.ndarray, unseen: np.ndarray) -> Figures:
    """Figures from a forest's classes of held-out clusters (K,) and of generated ones (U,), whose true classes are
    ``unseen`` (U,)."""
    user = held_out.labels != BACKGROUND
    size = np.bincount(held_out.groups)[held_out.groups[user]]
    hit = said[user] == held_out.labels[user]
    right = float(np.sum(hit / size) / max(np.sum(1.0 / size), 1e-9))
    false = np.sum(~user & (said != BACKGROUND) & (said != UNKNOWN)) / max(held_out.revolutions, 1)
    recall = [np.mean(said_unseen[unseen == c] == c) if np.any(unseen == c) else np.nan for c in range(len(CLASSES))]
    return Figures(right, float(false), np.array(recall))


def too_few(held_out: HeldOut) -> Iterator[str]:
    """An objection if too few road users were held out; needs no forest."""
    if held_out.users < MIN_USERS:
        yield (
            f"{held_out.users} road users moved far enough in the held-out part, {MIN_USERS} are needed: "
            "record longer, or at a busier time"
        )


def objections(before: Figures, after: Figures, held_out: HeldOut) -> Iterator[str]:
    """The reasons not to accept the new forest; none when it is accepted."""
    yield from too_few(held_out)
    if after.right < before.right - LOSS:
        yield f"road users called right fall from {before.right:.1%} to {after.right:.1%}"
    if after.false > before.false:
        yield f"false road users rise from {before.false:.2f} to {after.false:.2f} per revolution"
    fewer_false = after.false < before.false and after.false <= (1.0 - GAIN) * before.false  # 0 is not fewer than 0
    if after.right < before.right + GAIN and not fewer_false:
        yield "it is no better: the figures of road users called right and of false ones stay the same"
    for c, name in enumerate(CLASSES):
        if c != BACKGROUND and after.recall[c] < before.recall[c] - FORGOTTEN:
            yield f"{name} on generated streets falls from {before.recall[c]:.1%} to {after.recall[c]:.1%}"
