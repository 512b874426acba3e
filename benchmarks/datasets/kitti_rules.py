"""3-D tracking scores by the rules of AB3DMOT (Weng et al., IROS 2020), own implementation.

Truth of a neighbour class, occluded over 2 or truncated is ignored: no miss, and what it matches is neither right nor
wrong. Unmatched results are ignored up to 25 px of height or with more than half of their 2-D box in a DontCare area.
A track's score is the mean of its rows; cuts drop whole tracks. The cuts sit where recall passes 1/40 .. 40/40.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from benchmarks.datasets.box_overlap import overlap_3d
from benchmarks.datasets.kitti_format import NEIGHBOURS, Rows

CUTS = 40
MAX_OCCLUSION, MIN_HEIGHT_PX = 2, 25.0


@dataclass(frozen=True)
class Frame:
    """One frame, ready to be matched: g truths, r results."""

    truth_track: np.ndarray  # (g,)
    truth_ignored: np.ndarray  # (g,) bool
    result_track: np.ndarray  # (r,) index of the track in the sequence's list of scores
    result_ignored: np.ndarray  # (r,) bool, if unmatched
    overlap: np.ndarray  # (g, r)


@dataclass(frozen=True)
class Sequence:
    """All frames of one sequence."""

    frames: list[Frame]
    track_score: np.ndarray  # (T,) mean score of every result track


@dataclass(frozen=True)
class Scores:
    """One cut. ``truths`` without the ignored; ``matched_scores`` of every match, for placing the cuts."""

    truths: int
    hits: int
    misses: int
    false: int
    switches: int
    fragments: int
    overlap_sum: float
    matches: int
    matched_scores: np.ndarray

    @property
    def mota(self) -> float:
        """Share of 1; negative when there are more errors than truths."""
        return 1.0 - (self.misses + self.false + self.switches) / self.truths

    @property
    def motp(self) -> float:
        """Mean overlap of the matches."""
        return self.overlap_sum / self.matches if self.matches else 0.0

    def smota(self, recall: float) -> float:
        """MOTA scaled to what a recall of ``recall`` allows, 0..1."""
        errors = self.misses + self.false + self.switches - (1.0 - recall) * self.truths
        return min(1.0, max(0.0, 1.0 - errors / (recall * self.truths)))


@dataclass(frozen=True)
class Summary:
    """Averages over the cuts, shares of 1, and the scores at the cut with the best MOTA."""

    samota: float
    amota: float
    amotp: float
    best: Scores


def prepare(labels: Rows, results: Rows, kind: str) -> Sequence:
    """Keep what counts for one class, and compute every overlap once."""
    neighbour = NEIGHBOURS[kind]
    truth = labels.take((labels.kind == kind) | (labels.kind == neighbour))
    careless = labels.take(labels.kind == "DontCare")
    results = results.take(results.kind == kind)
    tracks, index = np.unique(results.track, return_inverse=True)
    score = np.bincount(index, results.score, len(tracks)) / np.maximum(np.bincount(index, minlength=len(tracks)), 1)
    ignored = (truth.kind == neighbour) | (truth.occluded > MAX_OCCLUSION) | (truth.truncated > 0)
    small = _too_small(results) | _in_careless_area(results, careless)
    last = max(truth.frame.max(initial=-1), results.frame.max(initial=-1))
    frames = []
    for number in range(last + 1):
        g, r = np.flatnonzero(truth.frame == number), np.flatnonzero(results.frame == number)
        overlap = overlap_3d(truth.box[g], results.box[r])
        frames.append(Frame(truth.track[g], ignored[g], index[r], small[r], overlap))
    return Sequence(frames, score)


def evaluate(sequences: list[Sequence], min_overlap: float = 0.25) -> Summary:
    """Scores over all sequences at once."""
    everything = at_cut(sequences, -np.inf, min_overlap)
    cuts = score_cuts(everything.matched_scores, everything.truths)
    rows = [at_cut(sequences, cut, min_overlap) for cut in cuts]
    if not rows:
        return Summary(0.0, 0.0, 0.0, everything)
    recalls = (np.arange(len(rows)) + 1) / CUTS
    best = int(np.argmax([row.mota for row in rows]))
    return Summary(
        samota=sum(row.smota(r) for row, r in zip(rows, recalls, strict=True)) / CUTS,
        amota=sum(row.mota for row in rows) / CUTS,
        amotp=sum(row.motp for row in rows) / CUTS,
        best=rows[best],
    )


def score_cuts(scores: np.ndarray, truths: int) -> list[float]:
    """The score at which recall is nearest to each of 1/40 .. 40/40; recalls never reached have none."""
    ordered = np.sort(scores)[::-1]
    cuts: list[float] = []
    wanted = 0.0
    for i, score in enumerate(ordered):
        here, following = (i + 1) / truths, (i + 2) / truths
        if i < len(ordered) - 1 and following - wanted < wanted - here:
            continue
        cuts.append(float(score))
        wanted += 1.0 / CUTS
    return cuts[1 : CUTS + 1]


def at_cut(sequences: list[Sequence], cut: float, min_overlap: float) -> Scores:
    """Match every frame with the tracks that score at least ``cut``."""
    total = Scores(0, 0, 0, 0, 0, 0, 0.0, 0, np.empty(0))
    scores: list[np.ndarray] = []
    for sequence in sequences:
        one, matched = _score_sequence(sequence, cut, min_overlap)
        scores.append(matched)
        total = replace(
            total,
            **{
                name: getattr(total, name) + getattr(one, name)
                for name in Scores.__dataclass_fields__
                if name != "matched_scores"
            },
        )
    return replace(total, matched_scores=np.concatenate(scores) if scores else np.empty(0))


def _score_sequence(sequence: Sequence, cut: float, min_overlap: float) -> tuple[Scores, np.ndarray]:
    keep_track = sequence.track_score >= cut
    truths = hits = misses = false = matches = 0
    overlap_sum = 0.0
    matched: list[float] = []
    story: dict[int, list[tuple[int, bool]]] = {}  # per truth: matched track (-1 = none) and whether ignored
    for frame in sequence.frames:
        kept = np.flatnonzero(keep_track[frame.result_track])
        rows, columns = _match(frame.overlap[:, kept], min_overlap)
        taken = np.zeros(len(kept), bool)
        taken[columns] = True
        columns = kept[columns]
        partner = np.full(len(frame.truth_track), -1)
        partner[rows] = frame.result_track[columns]
        for track, found, ignored in zip(
            frame.truth_track.tolist(), partner.tolist(), frame.truth_ignored.tolist(), strict=True
        ):
            story.setdefault(track, []).append((found, ignored))
        unmatched = kept[~taken]
        counted = ~frame.truth_ignored
        truths += np.count_nonzero(counted)
        hits += np.count_nonzero(counted[rows])
        misses += np.count_nonzero((partner < 0) & counted)
        false += np.count_nonzero(~frame.result_ignored[unmatched])
        matches += len(rows)
        overlap_sum += float(frame.overlap[rows, columns].sum())
        matched += sequence.track_score[frame.result_track[columns]].tolist()
    switches = fragments = 0
    for life in story.values():
        changed, broken = _count_changes(life)
        switches, fragments = switches + changed, fragments + broken
    scores = np.array(matched)
    return Scores(truths, hits, misses, false, switches, fragments, overlap_sum, matches, scores), scores


def _match(overlap: np.ndarray, min_overlap: float) -> tuple[np.ndarray, np.ndarray]:
    cost = np.where(overlap >= min_overlap, 1.0 - overlap, 1e9)
    rows, columns = linear_sum_assignment(cost)
    good = cost[rows, columns] < 1e9
    return rows[good], columns[good]


def _count_changes(life: list[tuple[int, bool]]) -> tuple[int, int]:
    """Identity switches and fragments of one truth. A switch needs two consecutive matched frames."""
    switches = fragments = 0
    last = life[0][0]
    for f in range(1, len(life)):
        track, ignored = life[f]
        before = life[f - 1][0]
        if ignored:
            last = -1
            continue
        if last not in (-1, track) and track != -1 and before != -1:
            switches += 1
        goes_on = f == len(life) - 1 or life[f + 1][0] != -1
        if before != track and last != -1 and track != -1 and goes_on:
            fragments += 1
        if track != -1:
            last = track
    return switches, fragments


def _too_small(results: Rows) -> np.ndarray:
    return np.asarray(results.box_px[:, 3] - results.box_px[:, 1] <= MIN_HEIGHT_PX)


def _in_careless_area(results: Rows, careless: Rows) -> np.ndarray:
    """More than half of the 2-D box inside one DontCare area of its frame."""
    inside = np.zeros(len(results.frame), bool)
    area = np.prod(np.maximum(results.box_px[:, 2:] - results.box_px[:, :2], 1e-9), axis=1)
    for frame, box in zip(careless.frame, careless.box_px, strict=True):
        rows = np.flatnonzero(results.frame == frame)
        low = np.maximum(results.box_px[rows, :2], box[:2])
        high = np.minimum(results.box_px[rows, 2:], box[2:])
        inside[rows] |= np.prod(np.maximum(high - low, 0.0), axis=1) > 0.5 * area[rows]
    return inside
