"""Footprints side by side: how far they reach and how far apart they are, against a plain way."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.infra_lidar import kernels_footprints as footprints
from services.infra_lidar import kernels_merge
from services.infra_lidar.jit import alone
from services.infra_lidar.vectors import LANES

make, place, extent = (alone(f) for f in (footprints.footprints, footprints.side_by_side, footprints.extent))
near_pairs, highest = alone(kernels_merge._near_pairs), alone(footprints.highest)
PIECE = st.tuples(
    st.floats(-30, 30, width=32), st.floats(-30, 30, width=32), st.floats(0, 9, width=32), st.floats(0, 3, width=32),
    st.floats(-3, 3, width=32), st.floats(0, 4, width=32),
)  # fmt: skip


def _boxes(pieces):
    """(K, 8) float32 of x, y, length, width, yaw, height, standing on the road, by their left ends."""
    box = np.zeros((len(pieces), 8), np.float32)
    box[:, [0, 1, 3, 4, 6, 5]] = pieces
    return box[np.argsort(box[:, 0] - np.hypot(box[:, 3], box[:, 4]) / 2)]


def _pieces(box):
    out = np.empty((footprints.ROWS, len(box) + LANES), np.float32)
    place(make(box), np.arange(len(box) + LANES, dtype=np.int32), len(box), out)
    return out


def _corners(one):
    c, s = np.cos(float(one[6])), np.sin(float(one[6]))
    half = np.array([(one[3], one[4]), (-one[3], one[4]), (-one[3], -one[4]), (one[3], -one[4])], float) / 2
    return one[:2].astype(float) + half @ np.array([[c, s], [-s, c]])


def _gap(one, other):
    """The smallest distance from a corner of one to the other."""
    nearest = np.inf
    for a, b in ((one, other), (other, one)):
        c, s = np.cos(float(b[6])), np.sin(float(b[6]))
        seen = (_corners(a) - b[:2]) @ np.array([[c, -s], [s, c]])
        outside = np.maximum(np.abs(seen) - b[3:5].astype(float) / 2, 0.0)
        nearest = min(nearest, np.hypot(*outside.T).min())
    return nearest


@given(st.lists(PIECE, min_size=1, max_size=40), st.floats(-3, 3))
@settings(deadline=None, max_examples=60)
def test_extents_are_those_of_all_corners(pieces, heading):
    box = _boxes(pieces)
    c, s = np.float32(np.cos(heading)), np.float32(np.sin(heading))
    corners = np.concatenate([_corners(one) for one in box])
    along, across = corners @ [c, s], corners @ [-s, c]
    expected = along.min(), along.max(), across.min(), across.max()
    assert extent(_pieces(box), len(box), c, s) == pytest.approx(expected, abs=1e-3)
    assert highest(_pieces(box), len(box)) == box[:, 5].max()


@given(st.lists(PIECE, min_size=1, max_size=40))
@settings(deadline=None, max_examples=60)
def test_pairs_are_those_within_the_gap_that_their_height_allows(pieces):
    box = _boxes(pieces)
    first, second, gaps = near_pairs(_pieces(box), len(box))
    found = dict(zip(zip(first.tolist(), second.tolist(), strict=True), gaps.tolist(), strict=True))
    for i in range(len(box)):
        for j in range(i + 1, len(box)):
            tall = max(box[i, 5], box[j, 5]) > np.float32(kernels_merge.SMALL_TOP_M)
            widest = kernels_merge.LARGE_GAP_M if tall else kernels_merge.SMALL_GAP_M
            gap = _gap(box[i], box[j])
            if (i, j) in found:
                assert found.pop((i, j)) == pytest.approx(gap, abs=1e-3)
                assert gap < widest + 1e-3
            else:
                assert gap > widest - 1e-3 or len(first) >= 16 * len(box) + 16  # no more have room
    assert not found
