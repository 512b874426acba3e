"""The compiled features against slow plain numpy, one cluster at a time, and against cases known by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from services.infra_lidar.classification.feature_kernels import MOST_POINTS
from services.infra_lidar.classification.features import ARTICLE_19, FEATURE_NAMES, compute_features

ALL = FEATURE_NAMES
COUNTED = ("num_points", "density", "points_by_range")
# What is told from heights in 255 bins, and by how many bins it may be off
RANKED = {"z_25": 1, "z_median": 1, "z_75": 1, "z_range_cleaned": 2, "ground_gap_ratio": 2}


def reference(p: np.ndarray, ground: float) -> dict[str, float]:
    """Table 3 of the facts, as plainly as it can be written."""
    p = p.astype(np.float64)
    n, z = len(p), np.sort(p[:, 2])
    values, vectors = np.linalg.eigh(np.cov(p[:, :2].T, bias=True))
    axes = vectors[:, ::-1]
    uv = p[:, :2] @ axes
    length, width = np.ptp(uv, axis=0)
    tall, spread, area = np.ptp(z), np.hypot(length, width), length * width
    small, middle, large = np.maximum(np.linalg.eigvalsh(np.cov(p.T, bias=True)), 1e-9)
    rank = {q: z[int(q / 100 * (n - 1))] for q in (5, 10, 25, 50, 75, 95)}
    level = np.minimum(((p[:, 2] - z[0]) / tall * 5).astype(int), 4)
    level[p[:, 2] >= z[-1]] = 5
    shares = np.array([np.mean(level == s) for s in range(5)])
    boxes = np.array([np.ptp(uv[level == s], axis=0) if np.sum(level == s) > 2 else (0.0, 0.0) for s in range(5)])
    diagonals = np.hypot(*boxes.T)
    return {
        "num_points": n, "xy_spread": spread, "xy_area": area, "z_range": tall, "height_to_footprint": tall / spread,
        "density": n / (area * np.sqrt(tall)), "z_25": rank[25] - ground, "z_75": rank[75] - ground,
        "z_std": p[:, 2].std(), "xy_aspect_ratio": values[1] / max(values[0], 1e-6), "scattering": small / large,
        "linearity": (large - middle) / large, "planarity": (middle - small) / large,
        **{f"layer_frac_{s}": shares[s] for s in range(5)},
        "cross_section_var": diagonals.std() if n > 20 else 0.0,
        "cross_section_mean": diagonals.mean() if n > 20 else 0.0,
        "z_range_cleaned": rank[95] - rank[5], "x_range": length, "y_range": width, "bbox_volume": area * tall,
        "z_median": rank[50] - ground, "ev_norm_0": small / (small + middle + large),
        "ev_norm_1": middle / (small + middle + large), "ev_norm_2": large / (small + middle + large),
        "vertical_uniformity": shares.std(), "bottom_to_top_ratio": min(shares[0] / max(shares[4], 1e-6), 1e3),
        "ground_gap_ratio": (rank[10] - rank[5]) / tall, "z_bottom": z[0] - ground, "z_top": z[-1] - ground,
        "range_m": np.hypot(*p[:, :2].mean(axis=0)),
        **{f"slice_length_{s}": boxes[s, 0] for s in range(5)},
        **{f"slice_width_{s}": boxes[s, 1] for s in range(5)},
    }  # fmt: skip


def cluster(seed: int, n: int, size: tuple[float, float, float], centre: tuple[float, float]) -> np.ndarray:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.5, 0.5, (n, 3)) * size
    turn = rng.uniform(-np.pi, np.pi)
    rotation = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    return (points @ rotation.T + [*centre, size[2] / 2 + 0.2]).astype(np.float32)


def stacked(clusters: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    return np.concatenate(clusters), np.cumsum([0, *map(len, clusters)])


def test_every_feature_equals_its_plain_definition() -> None:
    clusters = [
        cluster(1, 400, (4.4, 1.8, 1.5), (20.0, -7.0)),
        cluster(2, 90, (0.5, 0.6, 1.7), (-33.0, 4.0)),
        cluster(3, 25, (1.7, 0.6, 1.6), (5.0, 60.0)),
        cluster(4, 12, (11.0, 2.5, 3.0), (15.0, 15.0)),
        cluster(5, 1000, (6.0, 0.4, 2.0), (-8.0, -8.0)),
    ]
    ground = np.array([-0.4, 0.0, 1.0, 0.1, 0.0])
    points, offsets = stacked(clusters)
    got = compute_features(points, offsets, ground, ALL)
    for k, one in enumerate(clusters):
        for name, expected in reference(one, float(ground[k])).items():
            if name in ALL:
                off = RANKED.get(name, 0) / 255 * (1.0 if name == "ground_gap_ratio" else float(np.ptp(one[:, 2])))
                assert got[k, ALL.index(name)] == pytest.approx(expected, rel=2e-3, abs=2e-4 + off), (name, k)


def test_of_a_large_cluster_a_part_is_looked_at_and_all_points_are_counted() -> None:
    large, counted = cluster(6, 5000, (12.0, 2.5, 3.0), (15.0, 15.0)), [ALL.index(name) for name in COUNTED]
    whole = compute_features(*stacked([large]), np.zeros(1), ALL)[0]
    part = compute_features(*stacked([large[:: 5000 // MOST_POINTS + 1]]), np.zeros(1), ALL)[0]
    shape = np.setdiff1d(np.arange(len(ALL)), counted)
    assert np.array_equal(whole[shape], part[shape])
    assert whole[ALL.index("num_points")] == 5000.0
    sizes = whole[[ALL.index(name) for name in ("x_range", "y_range", "z_range")]]
    assert sizes == pytest.approx([12.0, 2.5, 3.0], rel=0.05)


@given(
    st.lists(st.sampled_from([0.0, 0.3, 1.4, 1.5]) | st.floats(0.0, 3.0, width=32), min_size=1, max_size=300),
    st.floats(-2.0, 2.0),
)
@settings(deadline=None, max_examples=60)
def test_percentiles_are_off_by_a_bin_of_height_at_most(heights: list[float], road_m: float) -> None:
    z = np.array(heights)
    points = np.column_stack([np.linspace(4.0, 5.0, len(z)), np.full(len(z), 2.0), z + road_m]).astype(np.float32)
    got = compute_features(points, np.array([0, len(z)]), np.array([road_m]), ("z_25", "z_median", "z_75"))[0]
    expected = np.sort(z)[[int(q * (len(z) - 1)) for q in (0.25, 0.5, 0.75)]]
    assert np.abs(got - expected).max() <= np.ptp(z) / 255 + 1e-5
    assert z.min() - 1e-5 <= got.min() <= got.max() <= z.max() + 1e-5


def test_columns_come_in_the_order_asked_for() -> None:
    points, offsets = stacked([cluster(1, 50, (4, 2, 1.5), (10, 0))])
    got = compute_features(points, offsets, np.zeros(1), ("z_range", "num_points"))
    assert got[0, 1] == 50
    assert got[0, 0] == pytest.approx(np.ptp(points[:, 2]))


@pytest.mark.parametrize("points", [1, 2, 3, 6, 7, 11, 16, 17, 33])
def test_tiny_and_flat_clusters_are_finite(points: int) -> None:
    same = np.full((points, 3), 7.0, np.float32)
    line = np.column_stack((np.arange(points), np.zeros(points), np.zeros(points))).astype(np.float32)
    flat, offsets = stacked([same, line])
    assert np.all(np.isfinite(compute_features(flat, offsets, np.zeros(2), ALL)))


def test_hull_fill_is_no_less_than_what_the_convex_hull_covers_and_not_much_more() -> None:
    rng = np.random.default_rng(0)
    square = (rng.uniform(0, 1, (4000, 3)) * [4.0, 2.0, 1.0]).astype(np.float32)
    shapes = [square, square[square[:, 1] < square[:, 0] / 2], square[np.hypot(*(square[:, :2] - [2, 1]).T) < 1]]
    shapes.append(square[:40])
    points, offsets = stacked(shapes)
    got = compute_features(points, offsets, np.zeros(len(shapes)), ("hull_fill", "xy_area"))
    for (fill, area), shape in zip(got, shapes, strict=True):
        hull = ConvexHull(shape[:, :2]).volume
        assert hull <= fill * area < 1.25 * hull


def _fill_by_clipping(place: np.ndarray) -> float:
    """The box of points (N, 2), cut by every line at 16 directions that supports them; slow and plain."""
    middle = place.mean(axis=0)
    across, along = np.linalg.eigh(np.cov((place - middle).T, bias=True))[1].T
    own = (place - middle) @ np.stack([along, across], axis=1)
    own /= np.ptp(own, axis=0)
    polygon = 2.0 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    for k in range(16):
        normal = np.array([np.cos(k * np.pi / 8), np.sin(k * np.pi / 8)])
        over, kept = polygon @ normal - (own @ normal).max(), []
        for i in range(len(polygon)):  # Sutherland and Hodgman 1974
            j = (i + 1) % len(polygon)
            if over[i] <= 0:
                kept.append(polygon[i])
            if over[i] * over[j] < 0:
                kept.append(polygon[i] + over[i] / (over[i] - over[j]) * (polygon[j] - polygon[i]))
        polygon = np.array(kept)
    x, y = polygon.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 10_000), n=st.integers(3, 300), step=st.sampled_from([0.0, 0.05, 0.5]),
    shape=st.sampled_from(["square", "disc", "ring", "corner"]), size=st.tuples(*[st.floats(0.2, 12.0)] * 2),
)  # fmt: skip
def test_hull_fill_is_that_of_the_lines_that_support_it(
    seed: int, n: int, step: float, shape: str, size: tuple[float, float]
) -> None:
    rng = np.random.default_rng(seed)
    place, turn = rng.uniform(-1, 1, (n, 2)), rng.uniform(0, 2 * np.pi, n)
    if shape == "disc":
        place = place[np.hypot(*place.T) <= 1]
    elif shape == "ring":  # every point is a corner, or nearly
        place = np.column_stack([np.cos(turn), np.sin(turn)])
    elif shape == "corner":  # what is seen of a car
        place[np.arange(n), rng.integers(0, 2, n)] = -1.0
    place = place * size
    place = np.round(place / step) * step if step else place  # in a grid many are in a line, or in one place
    points, offsets = stacked([np.column_stack([place, np.linspace(0, 1, len(place))]).astype(np.float32)])
    assume(len(place) >= 3 and np.linalg.matrix_rank(place - place.mean(axis=0), tol=1e-3) == 2)
    small, large = np.linalg.eigvalsh(np.cov(place.T, bias=True))
    assume(small > 1e-4 and large > 1.05 * small)  # else any direction is its main axis
    ((fill, area),) = compute_features(points, offsets, np.zeros(1), ("hull_fill", "xy_area"))
    assert fill == pytest.approx(_fill_by_clipping(points[:, :2].astype(np.float64)), rel=2e-3, abs=1e-4)
    assert ConvexHull(points[:, :2].astype(np.float64)).volume <= fill * area * 1.002 + 1e-4


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10_000), n=st.integers(1, 200), x=st.floats(-100, 100), y=st.floats(-100, 100),
    lift=st.floats(-5, 5), turn=st.floats(-3, 3),
)  # fmt: skip
def test_place_heading_and_slope_of_the_road_do_not_matter(
    seed: int, n: int, x: float, y: float, lift: float, turn: float
) -> None:
    names = ARTICLE_19
    one = cluster(seed, n, (3.0, 1.0, 1.5), (0.0, 0.0))
    c, s = np.cos(turn), np.sin(turn)
    moved = one @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + [x, y, lift]
    points, offsets = stacked([one, moved.astype(np.float32)])
    keep = [i for i, name in enumerate(names) if not name.startswith(("layer", "xy_aspect", "density", "cross"))]
    a, b = compute_features(points, offsets, np.array([0.0, lift]), names)[:, keep]
    np.testing.assert_allclose(a, b, rtol=0.05, atol=2e-3)


@pytest.mark.parametrize(
    ("points", "offsets", "names", "message"),
    [
        (np.zeros((4, 2)), [0, 4], ("z_25",), "points: expected shape"),
        (np.zeros((4, 3)), [0, 3], ("z_25",), "offsets: expected 0"),
        (np.zeros((4, 3)), [0, 4, 4], ("z_25",), "at least one point"),
        (np.zeros((4, 3)), [0, 4], ("z_26",), "unknown feature"),
    ],
)
def test_what_does_not_fit_is_refused(
    points: np.ndarray, offsets: list[int], names: tuple[str, ...], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        compute_features(points, np.array(offsets), np.zeros(len(offsets) - 1), names)


def test_no_cluster_is_no_row() -> None:
    assert compute_features(np.empty((0, 3)), np.zeros(1), np.empty(0), ALL).shape == (0, len(ALL))
