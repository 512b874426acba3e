"""Dark, frozen, covered, overexposed, blurred: made from a textured picture and from real ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from services.jetson.camera.config import HealthConfig
from services.jetson.camera.health import ViewMonitor, ViewState, measure, reduce

CONFIG = HealthConfig()
PERIOD_NS = 66_666_667
Change = Callable[[np.ndarray], np.ndarray]


def noisy(image: np.ndarray, seed: int, sigma: float = 2.0) -> np.ndarray:
    """Sensor noise, as every real picture has it."""
    noise = np.random.default_rng(seed).normal(0, sigma, image.shape)
    return np.clip(image.astype(np.float32) + noise, 0, 255).astype(np.uint8)


def blur(share: float) -> Change:
    return lambda image: cv2.GaussianBlur(image, (0, 0), image.shape[1] * share)


CHANGES: dict[str, Change] = {
    "dark": lambda image: (image * 0.2).astype(np.uint8),
    "covered": lambda image: (blur(0.15)(image) * 0.3 + 60).astype(np.uint8),  # a hand or a cloth on the lens
    "fogged": lambda image: (image * 0.1 + 180).astype(np.uint8),
    "overexposed": lambda image: np.clip(image.astype(np.float32) * 4 + 110, 0, 255).astype(np.uint8),
    "blurred": blur(0.015),
}
REASON = {"fogged": "covered or fogged", "covered": "covered or fogged"}


class Camera:
    """Feeds pictures to a monitor, 15 a second, each with its own noise."""

    def __init__(self) -> None:
        self.monitor = ViewMonitor(CONFIG)
        self._previous: np.ndarray | None = None
        self._count = self.begin_ns = 0

    def shows(self, image: np.ndarray, times: int = 1, noise: float = 2.0) -> ViewState:
        for _ in range(times):
            grey = reduce(noisy(image, self._count, noise) if noise else image)
            state = self.monitor.update(self.begin_ns + self._count * PERIOD_NS, measure(grey, self._previous))
            self._previous = grey
            self._count += 1
        return state


@pytest.mark.parametrize("fault", list(CHANGES))
def test_a_fault_is_told_with_its_evidence_and_goes_away(texture: np.ndarray, fault: str) -> None:
    camera = Camera()
    assert camera.shows(texture, 10) == ViewState(False, False, "")
    state = camera.shows(CHANGES[fault](texture), CONFIG.raise_frames)
    assert state.degraded
    name, _, evidence = state.reason.partition(": ")
    assert name == REASON.get(fault, fault)
    assert any(character.isdigit() for character in evidence)
    assert camera.shows(texture, CONFIG.clear_frames) == ViewState(False, False, "")


@pytest.mark.parametrize("fault", ["covered", "fogged", "overexposed", "blurred"])
def test_one_bad_picture_is_no_fault(texture: np.ndarray, fault: str) -> None:
    camera = Camera()
    camera.shows(texture, 5)
    assert not camera.shows(CHANGES[fault](texture), CONFIG.raise_frames - 1).degraded


def test_dark_blinds_at_once_and_needs_three_good_pictures(texture: np.ndarray) -> None:
    camera = Camera()
    camera.shows(texture, 5)
    assert camera.shows(CHANGES["dark"](texture)).blind
    assert camera.shows(texture, CONFIG.clear_frames - 1).blind
    assert not camera.shows(texture).degraded


@pytest.mark.parametrize(("brightness", "dark"), [(39.0, True), (40.0, False), (41.0, False)])
def test_the_limit_of_dark_is_forty(brightness: float, dark: bool) -> None:
    """A checkerboard of known mean; 40 itself is not dark."""
    image = np.full((480, 640, 3), brightness - 30, np.uint8)
    image[::2] = int(brightness + 30)
    state = Camera().shows(image, noise=0)
    assert state.blind is dark


def test_a_picture_that_never_changes_is_frozen_although_the_clock_is_set_back(texture: np.ndarray) -> None:
    camera = Camera()
    camera.shows(texture, 5, noise=0.0)
    camera.begin_ns -= 3600 * 10**9
    assert camera.shows(texture, 20, noise=0.0).reason.startswith("frozen: the same picture for 1.")


def test_between_the_limits_a_state_stays(texture: np.ndarray) -> None:
    """Hysteresis: 43 does not raise dark, and does not clear it either."""

    def at(brightness: float) -> np.ndarray:
        return (texture * (brightness / texture.mean())).astype(np.uint8)

    bright = Camera()
    assert not bright.shows(at(43), 20).blind
    dimmed = Camera()
    assert dimmed.shows(at(30)).blind
    assert dimmed.shows(at(43), 20).blind
    assert not dimmed.shows(at(60), 3).blind


def test_a_picture_that_never_changes_is_frozen_after_a_second(texture: np.ndarray) -> None:
    camera = Camera()
    camera.shows(texture, 3)
    assert not camera.shows(texture, 14, noise=0).degraded
    state = camera.shows(texture, 3, noise=0)
    assert state.blind
    assert state.reason.startswith("frozen: the same picture for 1.")
    assert not camera.shows(texture, 3).degraded


@pytest.mark.parametrize(
    ("rates_hz", "slow"),
    [
        ([1.5] * 4, False),
        ([1.5] * 5, True),
        ([15.0] * 10 + [0.5] + [15.0] * 3, False),  # one gap
        ([1.5] * 5 + [2.1] * 10, True),  # between the limits of the hysteresis
        ([1.5] * 5 + [3.0] * 2, True),
        ([1.5] * 5 + [3.0] * 3, False),
    ],
)
def test_pictures_that_come_rarely_are_told_as_slow(texture: np.ndarray, rates_hz: list[float], slow: bool) -> None:
    monitor, stamps_ns = ViewMonitor(CONFIG), np.cumsum([0, *(1e9 / rate_hz for rate_hz in rates_hz)])
    measures = measure(reduce(texture), None)
    state = [monitor.update(int(stamp_ns), measures) for stamp_ns in stamps_ns][-1]
    assert (state.degraded, state.blind, state.reason.startswith("too slow: 1.5 pictures a second, needs 2")) == (
        slow, False, slow,
    )  # fmt: skip


def test_a_reason_stays_as_it_was_when_the_fault_began(texture: np.ndarray) -> None:
    """Status is sent on every change of the reason: a figure that flickers would flood it."""
    camera = Camera()
    reasons = {camera.shows((texture * share).astype(np.uint8)).reason for share in (0.2, 0.15, 0.22, 0.1)}
    assert len(reasons) == 1


def test_a_still_scene_with_sensor_noise_is_not_frozen(texture: np.ndarray) -> None:
    assert not Camera().shows(texture, 40, noise=0.7).degraded


def real_pictures(folder: Path) -> list[np.ndarray]:
    paths = [folder / "bus.jpg", *sorted((folder / "kitti_tracking_0001").glob("*.png"))[:2]]
    pictures = [cv2.imread(str(path)) for path in paths]
    video = cv2.VideoCapture(str(folder / "one-by-one-person-detection.mp4"))
    for number in (0, 400):
        video.set(cv2.CAP_PROP_POS_FRAMES, number)
        pictures.append(video.read()[1])
    video.release()
    return [cv2.resize(picture, (640, 640 * picture.shape[0] // picture.shape[1])) for picture in pictures]


@pytest.mark.slow
def test_real_pictures_are_views_and_their_ruined_copies_are_not(recordings: Callable[[str], Path]) -> None:
    for picture in real_pictures(recordings("camera")):
        assert Camera().shows(picture, CONFIG.raise_frames) == ViewState(False, False, "")
        for fault, change in CHANGES.items():
            state = Camera().shows(change(picture), CONFIG.raise_frames)
            assert state.degraded, fault
            assert state.reason.startswith(REASON.get(fault, fault)), (fault, state.reason)


def test_a_real_video_of_a_room_is_neither_frozen_nor_covered(recordings: Callable[[str], Path]) -> None:
    camera = Camera()
    video = cv2.VideoCapture(str(recordings("camera") / "one-by-one-person-detection.mp4"))
    for _ in range(150):
        assert not camera.shows(video.read()[1], noise=0).degraded
    video.release()


@pytest.mark.slow
def test_real_pictures_that_repeat_are_frozen(recordings: Callable[[str], Path]) -> None:
    for picture in real_pictures(recordings("camera")):
        camera = Camera()
        assert not camera.shows(picture, 10).degraded
        assert not camera.shows(picture, 15, noise=0).degraded  # less than a second
        assert camera.shows(picture, 3, noise=0).reason.startswith("frozen: the same picture for 1.")
        assert not camera.shows(picture, CONFIG.clear_frames).degraded


def test_a_real_video_that_stops_is_frozen_until_it_goes_on(recordings: Callable[[str], Path]) -> None:
    camera, video = Camera(), cv2.VideoCapture(str(recordings("camera") / "one-by-one-person-detection.mp4"))
    for _ in range(20):
        picture = video.read()[1]
        assert not camera.shows(picture, noise=0).degraded
    states = [camera.shows(picture, noise=0) for _ in range(30)]
    assert [state.blind for state in states].index(True) in (13, 14)  # 15 a second; this video repeats some pictures
    assert states[-1].reason.startswith("frozen")
    moving = [camera.shows(video.read()[1], noise=0).degraded for _ in range(10)]
    video.release()
    assert not moving[-1]
