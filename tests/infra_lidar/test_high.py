"""High points against the rule told point by point."""

import numba
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from services.infra_lidar import kernels_high as kernels
from services.infra_lidar.vectors import LANES

BODY_M = np.float32(2.0)


@numba.njit(error_model="numpy")
def _free(points, label, number, lifted, high, high_label, top_label):
    highs, tops = kernels.find_high(points[3], label, BODY_M, high, high_label, top_label)
    high_label, top_label = high_label[:highs], top_label[:tops]
    spans = np.empty(len(label) + 2 * LANES, np.int32)
    tall = kernels.tall_ones(number, high_label, top_label, spans)
    return kernels.lift(points, label, tall, high[:highs], high_label, lifted)


@numba.njit(error_model="numpy")
def _spread(begin, label, out):
    kernels.spread(begin, label, out)


@numba.njit(error_model="numpy")
def _put_down(found, by, free, label):
    kernels.put_down(found, by, free, label)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 6 * LANES), st.integers(1, 4))
def test_who_reaches_up_to_a_body_s_height_keeps_what_is_above(seed, n, components):
    generator = np.random.default_rng(seed)
    room = generator.normal(size=(4, n + LANES)).astype(np.float32)
    points = room[:, :n]
    points[3] = generator.choice(np.float32([0.5, 1.59, 1.61, 1.99, 2.0, 3.0]), n, p=[0.6, 0.1, 0.05, 0.05, 0.1, 0.1])
    label = generator.integers(-1, components, n).astype(np.int32)
    low, high = points[3] < BODY_M, points[3] >= BODY_M
    band = low & (points[3] >= BODY_M - kernels.BAND_M)
    of = [label == k for k in range(components)]
    tall = [(band & mine).sum() >= max(kernels.FEWEST, kernels.SHARE * (low & mine).sum()) for mine in of]
    loose = high & ~np.any([mine & is_tall for mine, is_tall in zip(of, tall, strict=True)], axis=0)

    lifted, (high, high_label, top_label) = np.empty((4, n + LANES), np.float32), np.empty((3, n + LANES), np.int32)
    now = np.append(label, np.full(LANES, 10**6, np.int32))[:n]
    number = _free(
        room,
        now,
        np.bincount(label + 1, minlength=components + 1).astype(np.int32),
        lifted,
        high,
        high_label,
        top_label,
    )
    assert high[:number].tolist() == np.flatnonzero(loose).tolist()
    assert np.array_equal(lifted[:, :number], points[:, loose])
    assert np.array_equal(now, np.where(loose, -1, label))


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(1, 3 * LANES), st.integers(-1, 3)), max_size=9))
def test_every_point_has_the_label_of_its_run(runs):
    lengths, labels = (np.array([run[k] for run in runs], np.int32) for k in (0, 1))
    begin = np.concatenate(([0], np.cumsum(lengths))).astype(np.int32)
    out = np.empty(begin[-1] + LANES, np.int32)
    _spread(begin, labels, out)
    assert np.array_equal(out[: begin[-1]], np.repeat(labels, lengths))


def test_what_was_lifted_comes_back_under_later_numbers():
    label = np.array([0, -1, 1, -1, -1], np.int32)
    _put_down(np.array([0, -1, 1], np.int32), np.int32(2), np.array([1, 3, 4], np.int32), label)
    assert label.tolist() == [0, 2, 1, -1, 3]
