"""The background: what stands is forgotten, what moves stays, at every speed."""

from __future__ import annotations

import numpy as np
import pytest

from services.radar_pi.clutter import Clutter

MEMORY, CHIRPS = 0.92, 16


def still(value: complex) -> np.ndarray:
    return np.full((1, CHIRPS, 1), value, np.complex64)


def test_first_frame_seeds_the_background() -> None:
    assert np.allclose(Clutter(MEMORY, 15).remove(still(3 + 4j)), 0.0)


def test_a_new_reflector_fades_with_the_memory() -> None:
    clutter = Clutter(MEMORY, 15)
    clutter.remove(still(0.0))
    left = [abs(clutter.remove(still(10.0))[0, 0, 0]) for _ in range(30)]
    assert left == pytest.approx([10.0 * MEMORY**n for n in range(30)], rel=1e-4)


def test_after_fifteen_frames_71_percent_has_settled() -> None:
    clutter = Clutter(MEMORY, 15)
    clutter.remove(still(0.0))
    for _ in range(15):
        clutter.remove(still(1.0))
    assert clutter.background is not None
    assert abs(clutter.background[0, 0]) == pytest.approx(0.714, abs=0.001)


def test_memory_zero_is_the_frame_difference() -> None:
    clutter = Clutter(0.0, 15)
    clutter.remove(still(1.0))
    assert np.allclose(clutter.remove(still(5.0)), 4.0)
    assert np.allclose(clutter.remove(still(6.0)), 1.0)


def test_settling_lasts_its_frames_and_starts_again_after_a_reset() -> None:
    clutter = Clutter(MEMORY, 3)
    seen = []
    for _ in range(5):
        clutter.remove(still(1.0))
        seen.append(clutter.settled)
    assert seen == [False, False, False, True, True]
    clutter.reset()
    assert not clutter.settled
    assert clutter.background is None


@pytest.mark.parametrize("turns_per_frame", [0, 1, 2, 7])
def test_no_blind_speed_between_frames(turns_per_frame: int) -> None:
    """A body that moves by whole half wavelengths from frame to frame looks alike in each: it has to stay visible.

    A background per chirp would cancel it completely.
    """
    clutter = Clutter(MEMORY, 15)
    phase_in_frame = 2 * np.pi * 3 * np.arange(CHIRPS) / CHIRPS  # three Doppler bins
    for frame in range(40):
        body = np.exp(1j * (phase_in_frame + 2 * np.pi * turns_per_frame * frame))[None, :, None]
        left = clutter.remove(body.astype(np.complex64))
    assert np.abs(left).mean() > 0.95


def test_switched_off_it_only_watches() -> None:
    clutter = Clutter(MEMORY, 15, subtract=False)
    assert np.allclose(clutter.remove(still(2.0)), 2.0)
    assert clutter.background is not None
