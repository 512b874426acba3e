"""What stands in streets and is no road user, in many shapes, drawn at random; also heaps of arbitrary pieces.

Leaves are marked as such: rays return from somewhere inside them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from spotter_sim.solids import BOX, CYLINDER, SPHERE, Solids, join, solid

_Rng = np.random.Generator


def furniture(rng: _Rng) -> Solids:
    """One thing, now and then two that clustering would join."""
    made = [_MAKERS[rng.choice(len(_MAKERS), p=_P)](rng)]
    if rng.random() < 0.15:
        T = np.eye(4)
        T[:2, 3] = rng.uniform(-0.9, 0.9, 2)
        made.append(_MAKERS[rng.choice(len(_MAKERS), p=_P)](rng).placed(T, 0, np.zeros(3)))
    return join(made)


def _block(x: float, y: float, low: float, half: tuple[float, float], high: float, part: str = "metal") -> Solids:
    return solid(BOX, (x, y, 0.5 * (low + high)), (*half, 0.5 * (high - low)), "wall", part)


def _post(x: float, y: float, high: float, radius: float, low: float = 0.0) -> Solids:
    return solid(CYLINDER, (x, y, 0.5 * (low + high)), (radius, radius, 0.5 * (high - low)), "pole", "metal")


def _ball(rng: _Rng, place: tuple[float, float, float], least: float, most: float) -> Solids:
    a, b, c = rng.uniform(least, most, 3)
    return solid(SPHERE, place, (a, b, c), "bush", "leaves")


def _near(rng: _Rng, reach: float, z: float) -> tuple[float, float, float]:
    return rng.uniform(-reach, reach), rng.uniform(-reach, reach), z


def _lamp(rng: _Rng) -> Solids:
    high, radius = rng.uniform(1.5, 6.0), rng.uniform(0.04, 0.2)
    base = [_post(0.0, 0.0, rng.uniform(0.3, 1.2), radius * rng.uniform(1.2, 2.2))] if rng.random() < 0.4 else []
    arm = [_block(0.8, 0.0, high - 0.1, (0.8, 0.05), high)] if rng.random() < 0.3 else []
    return join([_post(0.0, 0.0, high, radius), *base, *arm])


def _sign(rng: _Rng) -> Solids:
    """A board on one or two posts, a traffic light, a totem."""
    wide, low = rng.uniform(0.12, 1.6), rng.uniform(0.5, 2.3)
    feet = (0.0,) if wide < 0.6 else (-0.8 * wide, 0.8 * wide)
    high = low + rng.uniform(0.3, 1.2)
    return join(
        [*(_post(0.0, y, high, rng.uniform(0.03, 0.1)) for y in feet), _block(0.06, 0.0, low, (0.04, wide), high)]
    )


def _tree(rng: _Rng) -> Solids:
    radius, lean = rng.uniform(0.05, 0.35), rng.normal(0.0, 0.15)
    high = rng.uniform(1.5, 4.0)
    boughs = [_ball(rng, _near(rng, 1.3, high + rng.uniform(-0.6, 1.0)), 0.4, 1.5) for _ in range(rng.integers(0, 5))]
    roots = [_ball(rng, (0.0, 0.0, 0.2), 0.2, 0.6)] if rng.random() < 0.3 else []
    return join([_post(lean, 0.0, high, radius), *boughs, *roots])


def _bushes(rng: _Rng) -> Solids:
    return join([_ball(rng, _near(rng, 1.1, rng.uniform(0.2, 1.0)), 0.25, 1.1) for _ in range(rng.integers(1, 7))])


def _hedge(rng: _Rng) -> Solids:
    long, wide, high = rng.uniform(0.5, 6.0), rng.uniform(0.2, 1.0), rng.uniform(0.5, 2.4)
    if rng.random() < 0.5:
        return _block(0.0, 0.0, 0.0, (long, wide), high, "leaves")
    count = max(2, int(long / 0.6))
    rows = np.linspace(-long, long, count)
    return join(
        [
            solid(
                SPHERE,
                (x, rng.normal(0, 0.15), 0.5 * high),
                (0.7, wide, 0.55 * high * rng.uniform(0.8, 1.2)),
                "bush",
                "leaves",
            )
            for x in rows
        ]
    )


def _thicket(rng: _Rng) -> Solids:
    """Shrubs and young trees in a strip beside the road, as large as a van or a bus, and as a piece of one."""
    long, deep, high = rng.uniform(0.8, 6.0), rng.uniform(0.4, 2.2), rng.uniform(1.5, 5.0)
    count = int(np.clip(long * deep * high * rng.uniform(0.4, 1.2), 4, 40))
    balls = []
    for _ in range(count):
        x, y, top = rng.uniform(-long, long), rng.uniform(-deep, deep), high * rng.uniform(0.55, 1.0)
        half = min(rng.uniform(0.3, 1.4), 0.5 * top)
        balls.append(_ball(rng, (x, y, top - half), 0.6 * half, half))
        if top > 2.0 * half and rng.random() < 0.8:  # leaves down to the ground, or a stem
            balls.append(_ball(rng, (x, y, 0.5 * (top - half)), 0.5 * half, half))
    stems = [_post(rng.uniform(-long, long), rng.uniform(-deep, deep), 0.7 * high, rng.uniform(0.03, 0.12))]
    return join([*balls, *stems])


def _wall(rng: _Rng) -> Solids:
    """Straight, or round a corner, or with openings."""
    long, thick, high = rng.uniform(0.4, 7.0), rng.uniform(0.04, 0.3), rng.uniform(0.5, 5.0)
    parts = [_block(0.0, 0.0, 0.0, (long, thick), high, "concrete")]
    if rng.random() < 0.3:
        deep = rng.uniform(0.5, 3.0)
        parts.append(_block(long, deep, 0.0, (thick, deep), high, "concrete"))
    return join(parts)


def _boxes(rng: _Rng) -> Solids:
    """Bins, cabinets, crates, parcel lockers, a kiosk."""
    a, b = rng.uniform(0.15, 0.8), rng.uniform(0.15, 0.7)
    high = rng.uniform(0.5, 1.9)
    if rng.random() < 0.12:
        a, b, high = rng.uniform(0.8, 1.6), rng.uniform(0.8, 1.3), rng.uniform(1.9, 2.8)
    return join(
        [_block((2 * a + 0.05) * i, 0.0, 0.0, (a, b), high * rng.uniform(0.9, 1.1)) for i in range(rng.integers(1, 5))]
    )


def _barrier(rng: _Rng) -> Solids:
    """Guard rail, concrete wall, railing, fence with boards, site fence."""
    long, kind = rng.uniform(1.0, 9.0), rng.integers(4)
    if kind == 0:
        foot = _block(0.0, 0.0, 0.0, (long, 0.28), 0.3, "concrete")
        return join([foot, _block(0.0, 0.0, 0.3, (long, 0.1), rng.uniform(0.75, 1.2), "concrete")])
    step, high = rng.uniform(1.0, 4.0), rng.uniform(0.7, 2.0)
    posts = [_post(x, 0.0, high, rng.uniform(0.03, 0.08)) for x in np.arange(-long, long + 0.1, step)]
    rails = rng.uniform(0.4, high, rng.integers(1, 4)) if kind < 3 else np.arange(0.15, high, 0.25)
    half = rng.uniform(0.02, 0.16)
    return join([*posts, *(_block(0.0, 0.05, float(z) - half, (long, 0.03), float(z) + half) for z in rails)])


def _bench(rng: _Rng) -> Solids:
    long, deep = rng.uniform(0.5, 1.3), rng.uniform(0.2, 0.3)
    parts = [_block(x, 0.0, 0.0, (0.05, deep), 0.42) for x in (-0.8 * long, 0.8 * long)]
    parts.append(_block(0.0, 0.0, 0.42, (long, deep), 0.5))
    if rng.random() < 0.7:
        parts.append(_block(0.0, deep, 0.5, (long, 0.04), rng.uniform(0.7, 0.95)))
    return join(parts)


def _shelter(rng: _Rng) -> Solids:
    long, deep, high = rng.uniform(0.6, 2.5), rng.uniform(0.5, 0.9), rng.uniform(2.2, 2.7)
    parts = [_block(0.0, 0.0, high, (long, deep), high + 0.12)]
    parts += [_post(x, y, high, 0.05) for x in (-long, long) for y in (-deep, deep)]
    if rng.random() < 0.6:
        parts.append(_block(0.0, deep, 0.2, (long, 0.03), high, str(rng.choice(["clear", "metal"]))))
    return join(parts)


def _row(rng: _Rng) -> Solids:
    """Bollards, cones, stumps."""
    high, radius, gap = rng.uniform(0.45, 1.3), rng.uniform(0.05, 0.3), rng.uniform(0.4, 1.6)
    return join([_post(gap * i, 0.0, high, radius) for i in range(rng.integers(1, 6))])


def _cycles(rng: _Rng) -> Solids:
    """One to five parked bicycles or mopeds: no road users without their riders."""
    made = []
    for i in range(rng.integers(1, 6)):
        y, wheel = 0.45 * i + rng.normal(0, 0.05), rng.uniform(0.22, 0.36)
        turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
        made += [
            solid(
                CYLINDER, (x, y, wheel), (wheel, wheel, 0.02), "pole", "clear" if rng.random() < 0.5 else "rubber", turn
            )
            for x in (-0.52, 0.52)
        ]
        made.append(_block(0.0, y, rng.uniform(0.3, 0.6), (0.45, 0.02), rng.uniform(0.6, 0.85)))
        made += [
            _block(0.38, y, 0.98, (0.03, rng.uniform(0.2, 0.32)), 1.03),
            _post(0.42, y, 1.0, 0.025, 0.4),
            _block(-0.22, y, 0.85, (0.12, 0.06), 0.92),
        ]
    return join(made)


def _planter(rng: _Rng) -> Solids:
    radius, high = rng.uniform(0.25, 1.4), rng.uniform(0.25, 0.8)
    pot = _post(0.0, 0.0, high, radius) if rng.random() < 0.5 else _block(0.0, 0.0, 0.0, (radius, 0.6 * radius), high)
    return join([pot, _ball(rng, (0.0, 0.0, high + 0.2), 0.2, 0.9 * radius + 0.15)])


def _heap(rng: _Rng) -> Solids:
    """Arbitrary pieces on and beside each other: what no list of things foresees."""
    made, reach = [], rng.uniform(0.2, 2.2)
    for _ in range(rng.integers(2, 8)):
        x, y, half = *rng.uniform(-reach, reach, 2), rng.uniform(0.05, 0.7, 3)
        shape = int(rng.choice([BOX, CYLINDER, SPHERE]))
        leaning = np.linalg.qr(rng.normal(size=(3, 3)))[0] if rng.random() < 0.4 else np.eye(3)
        made.append(
            solid(
                shape,
                (x, y, rng.uniform(0.1, 1.8)),
                tuple(half),
                "wall",
                str(rng.choice(["metal", "leaves", "concrete"])),
                leaning,
            )
        )
    return join(made)


def _arch(rng: _Rng) -> Solids:
    """A hoop: bicycle stand, goal, gate."""
    wide, high, radius = rng.uniform(0.3, 1.5), rng.uniform(0.7, 2.3), rng.uniform(0.02, 0.08)
    top = _block(0.0, 0.0, high - 2 * radius, (wide, radius), high)
    return join([_post(-wide, 0.0, high, radius), _post(wide, 0.0, high, radius), top])


_TABLE: tuple[tuple[Callable[[_Rng], Solids], float], ...] = (
    (_lamp, 1.0), (_sign, 1.0), (_tree, 1.6), (_bushes, 1.4), (_hedge, 1.2), (_thicket, 0.8), (_wall, 1.2),
    (_boxes, 1.2), (_barrier, 1.4), (_bench, 0.7), (_shelter, 0.6), (_row, 0.8), (_cycles, 1.0), (_planter, 0.6),
    (_heap, 0.8), (_arch, 0.5),
)  # fmt: skip
_MAKERS = [maker for maker, _ in _TABLE]
_P = np.array([weight for _, weight in _TABLE]) / sum(weight for _, weight in _TABLE)
