"""The evaluation rules by small made-up sequences; overlap against sampling; the recorded labels as results."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.datasets.box_overlap import overlap_3d
from benchmarks.datasets.kitti_format import Rows, data_folder, read_detections, read_rows, write_rows
from benchmarks.datasets.kitti_rules import Summary, at_cut, evaluate, prepare, score_cuts
from benchmarks.datasets.kitti_tracking import REFERENCE, score_class, track_sequence


def rows(
    places: list[tuple[int, int, float]], kind: str = "Car", score: float = 1.0, height_px: float = 100.0,
    occluded: float = 0, truncated: float = 0,
) -> Rows:  # fmt: skip
    """(frame, track, x) each; a car 20 m ahead."""
    n = len(places)
    frame, track, x = (np.array([p[i] for p in places]) for i in range(3))
    box = np.column_stack((x, np.full(n, 1.5), np.full(n, 20.0), np.tile([1.5, 1.8, 4.0, 0.3], (n, 1))))
    px = np.tile([0.0, 0.0, 50.0, height_px], (n, 1))
    flat = np.zeros(n)
    whole = frame.astype(int), track.astype(int)
    return Rows(*whole, np.full(n, kind), flat + truncated, flat + occluded, px, box, flat, flat + score)


def merged(*parts: Rows) -> Rows:
    return Rows(*(np.concatenate([getattr(p, name) for p in parts]) for name in Rows.__dataclass_fields__))


def run(labels: Rows, results: Rows, kind: str = "Car") -> Summary:
    return evaluate([prepare(labels, results, kind)])


LIFE = [(f, 1, 0.0) for f in range(10)]


def test_the_labels_as_results_are_perfect() -> None:
    life = [(f, 1, 0.0) for f in range(200)]
    got = run(rows(life), rows(life))
    assert (got.samota, got.amota, got.amotp, got.best.mota) == pytest.approx((1.0, 1.0, 1.0, 1.0))
    assert (got.best.misses, got.best.false, got.best.switches, got.best.fragments) == (0, 0, 0, 0)


def test_misses_false_ones_and_a_switch_are_counted() -> None:
    results = [(f, 7 if f < 5 else 8, 0.1) for f in range(10)] + [(f, 9, 30.0) for f in range(3)]
    got = at_cut([prepare(rows([*LIFE, (0, 2, 90.0)]), rows(results), "Car")], -np.inf, 0.25)
    assert (got.misses, got.false, got.switches, got.truths) == (1, 3, 1, 11)
    assert got.mota == pytest.approx(1 - 5 / 11)


def test_a_switch_over_a_gap_is_none_but_a_fragment() -> None:
    results = [(f, 7 if f < 5 else 8, 0.0) for f in range(10) if f != 5]
    got = at_cut([prepare(rows(LIFE), rows(results), "Car")], -np.inf, 0.25)
    assert (got.switches, got.fragments, got.misses) == (0, 1, 1)


@pytest.mark.parametrize(
    ("case", "label"),
    [
        ("neighbour class", {"kind": "Van"}),
        ("occluded", {"occluded": 3}),
        ("truncated", {"truncated": 1}),
    ],
)
def test_ignored_truth_counts_in_no_direction(case: str, label: dict[str, float]) -> None:
    labels = merged(rows(LIFE), rows([(f, 2, 40.0) for f in range(10)], **label))
    for results in (rows(LIFE), merged(rows(LIFE), rows([(f, 5, 40.0) for f in range(10)]))):
        got = at_cut([prepare(labels, results, "Car")], -np.inf, 0.25)
        assert (got.truths, got.misses, got.false) == (10, 0, 0), case


def test_unmatched_small_results_and_those_in_careless_areas_are_ignored() -> None:
    small = rows([(f, 5, 40.0) for f in range(10)], height_px=25.0)
    labels = merged(rows(LIFE), rows([(f, -1, 0.0) for f in range(10)], kind="DontCare"))
    hidden = rows([(f, 6, 60.0) for f in range(10)])
    got = at_cut([prepare(labels, merged(rows(LIFE), small, hidden), "Car")], -np.inf, 0.25)
    assert (got.false, got.misses) == (0, 0)
    far = Rows(**{**hidden.__dict__, "box_px": hidden.box_px + 500})
    assert at_cut([prepare(labels, merged(rows(LIFE), far), "Car")], -np.inf, 0.25).false == 10


def test_a_cut_drops_whole_tracks_by_their_mean_score() -> None:
    weak = rows([(f, 9, 30.0) for f in range(10)], score=0.2)
    sequence = [prepare(rows(LIFE), merged(rows(LIFE, score=0.8), weak), "Car")]
    assert at_cut(sequence, -np.inf, 0.25).false == 10
    assert at_cut(sequence, 0.5, 0.25).false == 0
    assert evaluate(sequence).best.mota == 1.0


def test_recalls_never_reached_count_nothing() -> None:
    life = [(f, 1, 0.0) for f in range(200)]
    assert run(rows(life), rows(life[:100])).samota == pytest.approx(0.5, abs=0.03)


def test_cuts_sit_where_recall_passes_the_fortieths() -> None:
    cuts = score_cuts(np.linspace(1, 0, 401), 400)
    assert len(cuts) == 40
    assert cuts == pytest.approx(1 - np.arange(1, 41) / 40, abs=0.003)


@pytest.mark.parametrize("turn", [0.0, 0.4, 1.2, np.pi / 2, 2.5])
def test_overlap_agrees_with_sampling(turn: float) -> None:
    rng = np.random.default_rng(0)
    a, b = np.array([0.0, 1.5, 20.0, 1.5, 1.8, 4.0, 0.3]), np.array([0.6, 1.3, 20.4, 1.7, 2.0, 4.4, 0.3 + turn])
    points = rng.uniform([-5, -1, 15], [5, 2, 25], (400_000, 3))

    def inside(box: np.ndarray) -> np.ndarray:
        dx, dz = points[:, 0] - box[0], points[:, 2] - box[2]
        c, s = np.cos(box[6]), np.sin(box[6])
        along, across = c * dx - s * dz, s * dx + c * dz
        tall = (points[:, 1] <= box[1]) & (points[:, 1] >= box[1] - box[3])
        return np.asarray((np.abs(along) <= box[5] / 2) & (np.abs(across) <= box[4] / 2) & tall)

    expected = np.sum(inside(a) & inside(b)) / np.sum(inside(a) | inside(b))
    assert overlap_3d(a[None], b[None])[0, 0] == pytest.approx(expected, abs=0.02)
    assert overlap_3d(a[None], a[None])[0, 0] == pytest.approx(1.0)


def test_result_files_read_back(tmp_path: Path) -> None:
    one = rows(LIFE, score=3.5)
    write_rows(tmp_path / "0000.txt", one)
    again = read_rows(tmp_path / "0000.txt")
    np.testing.assert_allclose(again.box, one.box)
    assert again.score.tolist() == one.score.tolist()
    assert again.kind.tolist() == one.kind.tolist()
    (tmp_path / "empty.txt").write_text("")
    assert len(read_rows(tmp_path / "empty.txt").frame) == 0


@pytest.mark.skipif(not data_folder().is_dir(), reason="no tracking-kitti in SPOTTER_DATA")
def test_recorded_labels_as_results_are_perfect() -> None:
    for kind in ("Car", "Pedestrian", "Cyclist"):
        sequences = []
        for path in sorted((data_folder() / "label").glob("*.txt"))[:3]:
            labels = read_rows(path)
            sequences.append(prepare(labels, labels, kind))
        got = at_cut(sequences, -np.inf, 0.25)
        assert (got.misses, got.false, got.switches) == (0, 0, 0)


@pytest.mark.slow
@pytest.mark.skipif(not data_folder().is_dir(), reason="no tracking-kitti in SPOTTER_DATA")
@pytest.mark.parametrize("kind", ["Car", "Pedestrian", "Cyclist"])
def test_recorded_detections_reach_the_reference_with_one_preset(kind: str) -> None:
    """AB3DMOT's own rows on the same unfiltered detections: sAMOTA, MOTA and no switch."""
    labels = {path.stem: read_rows(path) for path in sorted((data_folder() / "label").glob("*.txt"))}
    folder = data_folder() / f"detections_{kind.lower()}"
    results = {name: track_sequence(read_detections(folder / f"{name}.txt", kind), kind) for name in labels}
    got = score_class(kind, results, labels)
    assert 100 * got.samota >= REFERENCE[kind][0]
    assert 100 * got.best.mota >= REFERENCE[kind][3]
    assert got.best.switches == 0
