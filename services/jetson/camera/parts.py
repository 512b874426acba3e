"""Which parts of the picture see: eight upright strips, judged by blocks, as the lidar is judged by sectors.

A block of 20 x 20 pixels of the reduced picture speaks against its strip when it is

* empty:  exact repetition along rows or columns, as decoders fill what they lost; no lens and sensor give that
* frozen: the same grey levels, pixel by pixel, while other blocks change
* plain:  without fine detail for a long time: something on the lens, or a bare wall before it

The upper quarter of the picture does not count: it may be sky. Blocks under a box that the network found are not plain.
Bands that roll over the whole picture are told by a change from picture to picture that whole rows share.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from services.jetson.camera.config import HealthConfig

STRIPS = 8
ROWS, COLUMNS, BLOCK_PX = 12, 16, 20
SKY_ROWS = 3
SMALLEST_PX = (64, 160)  # rows, columns: smaller pictures are not judged by their parts
REPEATS_BELOW = 0.05  # grey levels between neighbours; compressed video stays above
LEVELS_JUDGED = (8.0, 247.0)  # darker and brighter blocks are clipped, and equal for that
BANDS_SHARE = 0.5  # of the change between two pictures
BANDS_EDGES = 3
BANDS_CHANGES = 4  # at least: a car that fills the picture, looked at half a second later, changes whole rows as well
_REASONS = {
    "empty": "no picture there; data are lost, look at cable and bandwidth",
    "frozen": "the picture stands still there; data are lost, look at cable and bandwidth",
    "plain": "nothing to see there for a long time; something on the lens, or a bare wall before it",
}


class Parts(NamedTuple):
    """``sees`` from left to right; empty = the picture is too small to tell."""

    sees: tuple[bool, ...]
    reason: str
    blind_ahead: bool  # a strip of the forward zone does not see


class _Blocks(NamedTuple):
    """(ROWS, COLUMNS) bool each."""

    empty: np.ndarray
    still: np.ndarray
    detailed: np.ndarray


class PartsMonitor:
    """Give it every picture; it keeps since when each block is plain or still, and counts."""

    def __init__(self, config: HealthConfig) -> None:
        self._config = config
        self._detail_ns: np.ndarray | None = None  # (ROWS, COLUMNS) int64: when it last had detail, or changed
        self._change_ns = np.zeros((ROWS, COLUMNS), np.int64)
        self._last_ns: int | None = None
        self._against = np.zeros(STRIPS, int)  # pictures in a row that speak against what is held
        self._blind = np.zeros(STRIPS, bool)
        self._bands = 0
        self._why = [""] * STRIPS

    def update(
        self, stamp_ns: int, grey: np.ndarray, previous: np.ndarray | None, boxes: np.ndarray, forward: float
    ) -> Parts:
        """The state after this reduced picture (h, w) uint8.

        ``boxes`` (N, 4) float: what the network found in the picture before, corners as shares of width and height.
        ``forward``: width of the zone in the middle, as a share, where less is tolerated.
        """
        if grey.shape[0] < SMALLEST_PX[0] or grey.shape[1] < SMALLEST_PX[1]:
            return Parts((), "", False)
        before = _even(previous) if previous is not None and previous.shape == grey.shape else None
        picture = _even(grey)
        shares = self._shares(stamp_ns, _blocks(picture, before, self._config.part_plain_below), boxes)
        ahead = _ahead(forward)
        self._count(shares, np.where(ahead, self._config.part_blind_above, self._config.part_beside_above))
        reason = self._reason(self._judge_bands(picture, before))
        return Parts(tuple(bool(one) for one in ~self._blind), reason, bool((self._blind & ahead).any()))

    def _shares(self, stamp_ns: int, blocks: _Blocks, boxes: np.ndarray) -> dict[str, np.ndarray]:
        """(STRIPS,) share of blocks that speak against each strip, by what they are."""
        if self._detail_ns is None:
            self._detail_ns = np.full((ROWS, COLUMNS), stamp_ns, np.int64)
            self._change_ns[:] = stamp_ns
        back_ns = max(0, (self._last_ns or stamp_ns) - stamp_ns)  # the clock was set back: how long is kept
        self._last_ns = stamp_ns
        self._detail_ns -= back_ns
        self._change_ns -= back_ns
        self._detail_ns[blocks.detailed | _under(boxes)] = stamp_ns
        self._change_ns[~blocks.still] = stamp_ns
        if blocks.still.all():  # frozen as a whole: the whole view is judged for that
            self._change_ns[:] = stamp_ns
        plain = stamp_ns - self._detail_ns > self._config.part_plain_after_s * 1e9
        frozen = stamp_ns - self._change_ns >= max(self._config.part_frozen_after_s, 1e-3) * 1e9
        if self._config.part_frozen_after_s == 0:
            frozen[:] = False
        found = {"empty": blocks.empty, "frozen": frozen, "plain": plain}
        return {name: _by_strip(value) for name, value in found.items()}

    def _count(self, shares: dict[str, np.ndarray], limits: np.ndarray) -> None:
        worst = np.max(list(shares.values()), axis=0)
        clear = worst <= limits * (1 - self._config.hysteresis)
        against = np.where(self._blind, clear, worst > limits)
        self._against = np.where(against, self._against + 1, 0)
        needed = np.where(self._blind, self._config.clear_frames, self._config.raise_frames)
        for strip in np.flatnonzero(self._against >= needed):
            self._blind[strip] = ~self._blind[strip]
            self._against[strip] = 0
            self._why[strip] = max(shares, key=lambda name: float(shares[name][strip]))

    def _judge_bands(self, picture: np.ndarray, before: np.ndarray | None) -> bool:
        rolling = before is not None and bands(picture, before) > self._config.bands_above
        needed = max(self._config.raise_frames, BANDS_CHANGES)
        most = needed + self._config.clear_frames
        self._bands = min(self._bands + 1, most) if rolling else max(self._bands - 1, 0)
        return self._bands >= needed

    def _reason(self, banded: bool) -> str:
        if not self._blind.any():
            return "bands roll over the picture: mains light, or a loose camera cable" if banded else ""
        why = [self._why[strip] for strip in np.flatnonzero(self._blind)]
        return f"{_where(self._blind)}: {_REASONS[max(_REASONS, key=why.count)]}"


def bands(picture: np.ndarray, before: np.ndarray) -> float:
    """Grey levels by which whole rows change in bands from one picture (240, 320) to the next; 0 = in no bands."""
    change = picture - before
    rows = cv2.blur(change.mean(axis=1, keepdims=True), (1, 5))[:, 0]
    rows -= rows.mean()
    spread = float(rows.std())
    strong = np.sign(rows[np.abs(rows) > spread / 2])
    edges = int((np.diff(strong) != 0).sum())
    shared = spread**2 > BANDS_SHARE * float(change.var())
    return spread if shared and edges >= BANDS_EDGES else 0.0


def _even(grey: np.ndarray) -> np.ndarray:
    """(240, 320) float32, so that blocks do not depend on the camera's shape."""
    size = (COLUMNS * BLOCK_PX, ROWS * BLOCK_PX)
    even = grey if grey.shape == size[::-1] else cv2.resize(grey, size, interpolation=cv2.INTER_LINEAR)
    return even.astype(np.float32)


def _blocks(picture: np.ndarray, before: np.ndarray | None, plain_below: float) -> _Blocks:
    fine = cv2.GaussianBlur(picture, (0, 0), 1.2) - cv2.GaussianBlur(picture, (0, 0), 4.0)
    detailed = np.sqrt(_mean(fine**2)) >= plain_below
    level = _mean(picture)
    judged = (level > LEVELS_JUDGED[0]) & (level < LEVELS_JUDGED[1])
    down = _mean(np.abs(np.diff(picture, axis=0, append=picture[-2:-1])))
    along = _mean(np.abs(np.diff(picture, axis=1, append=picture[:, -2:-1])))
    empty = judged & (np.minimum(down, along) < REPEATS_BELOW)
    still = judged & (_mean(np.abs(picture - before)) == 0) if before is not None else np.zeros_like(judged)
    return _Blocks(empty, still, detailed)


def _mean(values: np.ndarray) -> np.ndarray:
    return np.asarray(values.reshape(ROWS, BLOCK_PX, COLUMNS, BLOCK_PX).mean(axis=(1, 3)))


def _by_strip(blocks: np.ndarray) -> np.ndarray:
    return np.asarray(blocks[SKY_ROWS:].reshape(ROWS - SKY_ROWS, STRIPS, COLUMNS // STRIPS).mean(axis=(0, 2)))


def _ahead(forward: float) -> np.ndarray:
    """(STRIPS,) bool: reaches into the forward zone, a share of the width in the middle."""
    left = np.arange(STRIPS) / STRIPS
    return np.asarray((left < 0.5 + forward / 2) & (left + 1 / STRIPS > 0.5 - forward / 2))


def _under(boxes: np.ndarray) -> np.ndarray:
    """(ROWS, COLUMNS) bool: the block's centre lies in a box."""
    rows = (np.arange(ROWS) + 0.5)[:, None, None] / ROWS
    columns = (np.arange(COLUMNS) + 0.5)[None, :, None] / COLUMNS
    left, top, right, bottom = np.asarray(boxes, np.float64).reshape(-1, 4).T
    return np.asarray(((columns >= left) & (columns <= right) & (rows >= top) & (rows <= bottom)).any(axis=2))


def _where(blind: np.ndarray) -> str:
    """For example "blind from 25 % to 75 % of the picture's width"."""
    strips = np.flatnonzero(blind)
    first, last = int(strips[0]), int(strips[-1]) + 1
    return f"blind from {100 * first / STRIPS:.0f} % to {100 * last / STRIPS:.0f} % of the picture's width"
