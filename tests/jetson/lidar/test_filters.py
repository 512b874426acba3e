"""Which returns are believed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from common.messages import LaserScan
from services.jetson.lidar.config import FilterSection, MountingSection
from services.jetson.lidar.filters import RejectReason, judge, returns_of

Scan = Callable[..., LaserScan]


def reject_reasons(scan: LaserScan, mounting: MountingSection | None = None, **filters: float) -> np.ndarray:
    """The ``RejectReason`` of each beam in the scan's own order."""
    mounting = mounting or MountingSection()
    returns = returns_of(scan, mounting)
    reject_reason = judge(returns, FilterSection(**filters), mounting)  # type: ignore[arg-type]
    result = np.empty_like(reject_reason)
    result[returns.order] = reject_reason
    return result


def change(scan: LaserScan, beams: slice | list[int], range_m: float, confidence: int = 200) -> LaserScan:
    scan.ranges_m[beams], scan.confidence[beams] = range_m, confidence
    return scan


@pytest.mark.parametrize(
    ("range_m", "confidence", "reject_reason"),
    [
        (0.0, 0, RejectReason.NO_ECHO),
        (0.0, 99, RejectReason.NO_ECHO),
        (0.0, 100, RejectReason.ECHO_ONLY),
        (float("nan"), 0, RejectReason.NO_ECHO),
        (float("inf"), 0, RejectReason.NO_ECHO),
        (0.199, 200, RejectReason.NEAR),
        (0.2, 200, RejectReason.USED),
        (12.0, 200, RejectReason.USED),
        (12.01, 200, RejectReason.FAR),
        (2.0, 14, RejectReason.WEAK),
        (2.0, 15, RejectReason.USED),
    ],
)
def test_each_reject_reason(scan_of: Scan, range_m: float, confidence: int, reject_reason: RejectReason) -> None:
    front = slice(215, 235)
    assert set(reject_reasons(change(scan_of([], 3.0), front, range_m, confidence))[front]) == {int(reject_reason)}


def test_the_geometric_check_finds_what_the_floor_lets_through(scan_of: Scan) -> None:
    """A mast 0.25 m behind the sensor is beyond the 0.20 m floor and stands on the vehicle."""
    mast = slice(0, 6)  # straight behind
    assert set(reject_reasons(change(scan_of([], 3.0), mast, 0.25))[mast]) == {int(RejectReason.BODY)}
    assert set(reject_reasons(change(scan_of([], 3.0), mast, 0.40))[mast]) == {int(RejectReason.USED)}
    # A sensor set back by 0.3 m looks over a bonnet, which is in the forward cone
    bonnet = slice(220, 230)
    set_back = MountingSection(front_m=0.30)
    assert set(reject_reasons(change(scan_of([], 3.0), bonnet, 0.28), set_back)[bonnet]) == {int(RejectReason.BODY)}
    assert set(reject_reasons(change(scan_of([], 3.0), bonnet, 0.34), set_back)[bonnet]) == {int(RejectReason.USED)}


@pytest.mark.parametrize(
    ("beams", "confidence", "believed"),
    [([225], 255, False), ([225, 226], 200, False), ([225, 226], 220, True), ([225, 226, 227], 30, True)],
)
def test_isolated_returns(scan_of: Scan, beams: list[int], confidence: int, believed: bool) -> None:
    reject_reason = reject_reasons(change(scan_of([], 3.0), beams, 0.6, confidence))
    assert set(reject_reason[beams]) == {int(RejectReason.USED if believed else RejectReason.ISOLATED)}
    assert np.count_nonzero(reject_reason == RejectReason.USED) == 450 - (0 if believed else len(beams))


def test_ghosts_in_front_of_a_wall_do_not_spoil_the_wall(scan_of: Scan) -> None:
    scan = scan_of([], 2.0)
    ghosts = list(range(200, 250, 3))
    for number, beam in enumerate(ghosts):
        change(scan, [beam], 0.5 + 0.3 * (number % 3), 60)
    reject_reason = reject_reasons(scan)
    assert set(reject_reason[ghosts]) == {int(RejectReason.ISOLATED)}
    assert np.count_nonzero(reject_reason == RejectReason.USED) == 450 - len(ghosts)


@pytest.mark.parametrize("aside_m", [0.5, 0.8, 1.2])
def test_a_flank_seen_at_a_flat_angle_is_no_rain(scan_of: Scan, aside_m: float) -> None:
    """The side of a parked car, up to 5 m ahead: every return alone by its range, all on one line."""
    scan = scan_of([], 9.0)
    flank = np.flatnonzero((scan.angles_rad > np.arcsin(aside_m / 4.9)) & (scan.angles_rad < np.radians(20.0)))
    noise = 0.01 * np.random.default_rng(2).standard_normal(len(flank))
    scan.ranges_m[flank] = aside_m / np.sin(scan.angles_rad[flank]) + noise
    reject_reason = reject_reasons(scan)
    assert RejectReason.ISOLATED not in reject_reason[flank]
    assert RejectReason.GRAZING in reject_reason[flank]


def test_drops_lie_in_line_by_chance_only(scan_of: Scan) -> None:
    rng, scan = np.random.default_rng(3), scan_of([], 9.0)
    drops = rng.random(450) < 0.5
    scan.ranges_m[drops] = rng.uniform(0.3, 4.9, drops.sum())
    reject_reason = reject_reasons(scan)[drops]
    assert np.mean(reject_reason == RejectReason.GRAZING) < 0.15
    assert np.mean(reject_reason == RejectReason.ISOLATED) > 0.6


def test_order_of_the_beams_does_not_matter(scan_of: Scan) -> None:
    scan = change(scan_of([(0.5, -0.1, 0.1)], 3.0), [100], 1.0)
    shuffle = np.random.default_rng(1).permutation(450)
    shuffled = LaserScan(
        stamp_ns=0,
        angles_rad=scan.angles_rad[shuffle],
        ranges_m=scan.ranges_m[shuffle],
        confidence=scan.confidence[shuffle],
    )
    np.testing.assert_array_equal(reject_reasons(shuffled), reject_reasons(scan)[shuffle])


def test_no_beams_at_all() -> None:
    empty = np.empty(0, np.float32)
    assert (
        len(reject_reasons(LaserScan(stamp_ns=0, angles_rad=empty, ranges_m=empty, confidence=empty.astype("u1")))) == 0
    )
