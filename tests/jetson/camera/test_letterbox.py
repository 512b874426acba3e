"""Laying a picture into the network's input and finding the way back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.jetson.camera.letterbox import Fit, letterbox, undo


@pytest.mark.parametrize(
    ("picture", "size", "expected"),
    [
        ((1242, 375), (640, 640), Fit(640 / 1242, 0, 223)),  # a wide street picture: bars above and below
        ((810, 1080), (640, 640), Fit(640 / 1080, 80, 0)),  # portrait: bars left and right
        ((640, 480), (320, 256), Fit(0.5, 0, 8)),  # the demo network
        ((96, 64), (96, 64), Fit(1.0, 0, 0)),  # fits as it is
        ((48, 32), (96, 64), Fit(2.0, 0, 0)),  # enlarged
    ],
)
def test_the_fit_keeps_the_aspect_and_centres_the_picture(
    picture: tuple[int, int], size: tuple[int, int], expected: Fit
) -> None:
    blob, fit = letterbox(np.zeros((picture[1], picture[0], 3), np.uint8), *size)
    assert blob.shape == (1, 3, size[1], size[0])
    assert blob.dtype == np.float32
    assert fit == pytest.approx(expected)


def test_channels_are_rgb_in_0_to_1_and_bars_are_grey() -> None:
    image = np.zeros((100, 200, 3), np.uint8)
    image[..., 0], image[..., 2] = 51, 255  # blue, red
    blob, _ = letterbox(image, 200, 200)
    assert blob[0, :, 100, 100] == pytest.approx([1.0, 0.0, 0.2], abs=1e-6)
    assert blob[0, :, 0, 0] == pytest.approx([114 / 255] * 3, abs=1e-6)


def test_a_picture_of_the_right_size_arrives_unchanged() -> None:
    image = np.random.default_rng(1).integers(0, 256, (64, 96, 3), dtype=np.uint8)
    blob, _ = letterbox(image, 96, 64)
    reference = np.stack([image[..., channel] for channel in (2, 1, 0)])[None] / np.float32(255)
    np.testing.assert_allclose(blob, reference, atol=1e-6)


@given(
    width=st.integers(16, 2000), height=st.integers(16, 2000),
    left=st.floats(0, 0.9), top=st.floats(0, 0.9), wide=st.floats(0.01, 0.1), high=st.floats(0.01, 0.1),
)  # fmt: skip
def test_undo_inverts_the_fit(width: int, height: int, left: float, top: float, wide: float, high: float) -> None:
    box = np.array([[left * width, top * height, (left + wide) * width, (top + high) * height]], np.float32)
    scale = min(640 / width, 640 / height)
    fit = Fit(scale, (640 - max(1, round(width * scale))) // 2, (640 - max(1, round(height * scale))) // 2)
    laid = box * np.float32(scale) + np.array([fit.left_px, fit.top_px] * 2, np.float32)
    np.testing.assert_allclose(undo(laid, fit, width, height), box, atol=0.01 * max(1.0, 1 / scale))


def test_boxes_are_clipped_to_the_picture() -> None:
    clipped = undo(np.array([[-50.0, -50.0, 900.0, 900.0]], np.float32), Fit(0.5, 0, 8), 640, 480)
    np.testing.assert_allclose(clipped, [[0, 0, 640, 480]])
