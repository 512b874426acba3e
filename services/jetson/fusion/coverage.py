"""SAFE says only what was seen: which part of the way ahead could any sensor have seen an obstacle in?

Each sensor publishes its ``Cover``: sectors around its place and how far it could have seen in each. They are laid over
the way that the vehicle needs to stop, cell by cell. A cell counts as seen when one online sensor could have seen an
obstacle there; one that only sees what moves (a standing radar) covers nothing, since obstacles stand. The uncovered
part that begins nearer than the stopping distance makes the verdict at least CAUTION (``V1-uncovered``), with the speed
at which the vehicle would stop within what is covered.

A lidar sees what crosses its plane and a camera what its network knows: a low box or a pane is neither. While no sensor
that sees obstacles of every kind is online, the same rule holds above ``rules.partial_mps``. It also holds for a
vehicle that passes a place too fast where somebody may stand unseen (``hidden.py``). Pure.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal, NamedTuple

import numpy as np

from common.messages import Cover, Motion, Uncovered, WayAhead
from common.path import Path, PathConfig, is_driving, safe_speed_mps
from common.topics import spoken
from services.jetson.fusion.config import RulesConfig
from services.jetson.fusion.hidden import cover_far_m, nearest_hidden_m, pass_speed_mps, shows_what_hides

CELL_M = 0.1  # along the way
ACROSS = 5  # cells over its width
REACH_M = 12.0  # nothing farther is asked for
LIMIT_ROOM = 1.1  # a vehicle that keeps to a speed is measured a little faster now and then
NEAR_M = 0.6  # a cone from the bumper is narrower than the vehicle up to here


class Coverage(NamedTuple):
    """What is seen of the way ahead. ``covered_m`` and the speed are None when no sensor says what it covers."""

    way: WayAhead
    covered_m: float | None  # from the bumper, all cells up to there are seen; ``REACH_M`` at most
    uncovered: tuple[Uncovered, ...]  # up to the stopping distance, or to 3 m while less is needed
    max_safe_speed_mps: float | None  # stops within ``covered_m``, and no more than the limit where there is one
    limited_by: str = ""  # why there is a limit of its own to the speed, in words
    too_fast: bool = False  # for that limit

    @property
    def falls_short(self) -> bool:
        """The vehicle drives, and would not stop within what is covered."""
        short = self.covered_m is not None and self.covered_m < self.way.stopping_m
        return self.way.motion == "driving" and (short or self.too_fast)


def way_ahead(motion: Motion | None, config: PathConfig) -> tuple[Path, WayAhead]:
    """The path, straight unless the vehicle is known to drive, and the same for people."""
    driving = is_driving(motion, config)
    path = Path(config, motion if driving else None)
    kind: Literal["driving", "standing", "reversing", "unknown"] = "driving"
    if motion is None:
        kind = "unknown"
    elif not driving:
        kind = "reversing" if motion.speed_mps <= -config.moving_mps else "standing"
    return path, WayAhead(
        motion=kind,
        curvature_per_m=round(path.curvature_per_m, 4),
        left_m=round(path.left_m, 3),
        right_m=round(path.right_m, 3),
        stopping_m=round(path.stopping_m, 2),
    )


def cover_way(
    motion: Motion | None,
    config: PathConfig,
    covers: Mapping[str, Cover | None],
    out: Mapping[str, str],
    rules: RulesConfig,
) -> Coverage:
    """Lay the sensors' covers over the way.

    Args:
        motion: of the vehicle, None = unknown.
        covers: by sensor, of those that are online; None = it does not say, and covers nothing.
        out: the states of the sensors that are not online, by name.
        rules: how fast to drive while only obstacles of some kinds are seen, and past places that are out of sight.
    """
    path, way = way_ahead(motion, config)
    if all(cover is None for cover in covers.values()):
        return Coverage(way, None, (), None)
    cells = strip(path)
    seen = np.zeros(len(cells), bool)
    for cover in covers.values():
        if cover is not None and cover.standing:
            seen |= sees(cover, cells)
    rows: np.ndarray = np.all(seen.reshape(-1, ACROSS), axis=1)
    first_blind = int(np.argmin(rows)) if not rows.all() else len(rows)
    covered_m = round(first_blind * CELL_M, 2)
    needed = rows[: int(np.ceil(max(path.stopping_m, 3.0) / CELL_M))]
    gaps = tuple(
        Uncovered(from_m=round(begin * CELL_M, 2), to_m=round(end * CELL_M, 2), why=why_not(covers, out))
        for begin, end in runs(~needed)
    )
    limit_mps, limited_by = limit(path, covers, covered_m, rules)
    too_fast = motion is not None and motion.speed_mps > LIMIT_ROOM * limit_mps
    safe_mps = round(min(safe_speed_mps(covered_m, config), limit_mps), 2)
    return Coverage(way, covered_m, gaps, safe_mps, limited_by, too_fast)


def limit(path: Path, covers: Mapping[str, Cover | None], covered_m: float, rules: RulesConfig) -> tuple[float, str]:
    """The speed to keep to although the way is free, m/s, and why; infinite where there is no reason."""
    found = [(math.inf, "")]
    partial = partial_sight(covers)
    if partial:
        found.append((rules.partial_mps, f"low boxes and panes go unseen ({partial})"))
    hidden_m = nearest_hidden_m(path, covers.values(), covered_m)
    if not any(shows_what_hides(cover) for cover in covers.values()):
        limit_mps = pass_speed_mps(0.0, path.config, rules.hidden_stop_s)
        found.append((limit_mps, "no sensor shows what may hide somebody beside the way"))
    elif hidden_m is not None:
        limit_mps = pass_speed_mps(hidden_m, path.config, rules.hidden_stop_s)
        found.append((limit_mps, f"somebody may stand unseen beside the way {hidden_m:.1f} m ahead"))
    return min(found)


def partial_sight(covers: Mapping[str, Cover | None]) -> str:
    """What alone is seen, in words; empty while a sensor sees obstacles of every kind."""
    looking = {name: cover for name, cover in covers.items() if cover is not None and cover.standing}
    if not looking or any(not cover.only for cover in looking.values()):
        return ""
    return ", ".join(f"{spoken(name)} sees {cover.only}" for name, cover in looking.items())


def strip(path: Path) -> np.ndarray:
    """(N, 2) cells of the way in the vehicle's frame, ``ACROSS`` of them for each ``CELL_M`` up to ``REACH_M``."""
    steps = np.arange(CELL_M / 2, REACH_M, CELL_M)
    half = np.linspace(-path.right_m, path.left_m, ACROSS)
    ahead, beside = (grid.ravel() for grid in np.meshgrid(steps, half, indexing="ij"))
    return path.place(ahead, beside)


def sees(cover: Cover, cells: np.ndarray) -> np.ndarray:
    """(N,) bool: places (N, 2) in the vehicle's frame in which the sensor could have seen an obstacle.

    Ahead of it and nearer than its least range, or beside its cone within ``NEAR_M``, it is not asked: what is there
    came through what it sees, as long as it sees straight ahead at all.
    """
    if not any(cover.far_m) or cover.step_rad <= 0.0:
        return np.zeros(len(cells), bool)
    x, y = cells[:, 0] - cover.x_m, cells[:, 1] - cover.y_m
    range_m = np.hypot(x, y)
    near = (range_m <= max(cover.near_m, NEAR_M)) & (x > 0.0)
    sees_ahead = bool(cover_far_m(cover, np.zeros(())) > 0.0)
    return np.asarray(np.where(near, sees_ahead, cover_far_m(cover, np.arctan2(y, x)) >= range_m))


def runs(flags: np.ndarray) -> list[tuple[int, int]]:
    """First and one past the last index of each run of True in (N,) bool."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], flags.astype(int), [0]))))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def why_not(covers: Mapping[str, Cover | None], out: Mapping[str, str]) -> str:
    """Why a part of the way is not seen: what each sensor lacks, in words."""
    words = [f"{spoken(name)} {reason}" for name, reason in out.items()]
    for name, cover in covers.items():
        if cover is None:
            words.append(f"{spoken(name)} does not say what it covers")
        elif not cover.standing:
            words.append(f"{spoken(name)} sees only what moves")
        elif cover.why:
            words.append(f"{spoken(name)}: {cover.why}")
    return "; ".join(words) or "beyond what the sensors cover"
