"""Parts of the picture that do not see: stickers, lost data, frozen halves, rolling bands, and what is none."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import cv2
import msgspec
import numpy as np
import pytest

from services.jetson.camera.config import CameraConfig, HealthConfig
from services.jetson.camera.health import reduce
from services.jetson.camera.parts import Parts, PartsMonitor, bands
from services.jetson.camera.pipeline import CameraPipeline
from services.jetson.camera.source import fitted
from spotter_sim import camera as simulated

START_NS = 1_800_000_000_000_000_000
NO_BOXES = np.zeros((0, 4))
Fault = Callable[[np.ndarray, int], np.ndarray]


def noisy(image: np.ndarray, seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0, 2.0, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


def sticker(softness_px: float) -> Fault:
    """Over the middle half of the picture, out of focus by so much."""
    mask = np.zeros((480, 640), np.float32)
    mask[120:360, 160:480] = 1.0
    share = cv2.GaussianBlur(mask, (0, 0), softness_px)[..., None]
    return lambda image, number: noisy(image * (1 - share) + share * np.array((60, 160, 200)), number)


def lower(row: int, fill: tuple[int, int, int] | None) -> Fault:
    """Rows from ``row`` on that a decoder filled: with a colour, or with the last good row."""

    def change(image: np.ndarray, number: int) -> np.ndarray:
        picture = noisy(image, number)
        picture[row:] = picture[row - 1] if fill is None else fill
        return picture

    return change


def left_half_frozen(image: np.ndarray, number: int) -> np.ndarray:
    picture = noisy(image, number)
    picture[:, :320] = image[:, :320]
    return picture


def rolling_bands(image: np.ndarray, number: int) -> np.ndarray:
    phase = np.arange(480) / 480 * 3 - number * 0.11
    return noisy(image * np.where(np.sin(2 * np.pi * phase) > 0, 0.5, 1.0)[:, None, None], number)


def shown(
    pictures: Iterator[np.ndarray],
    period_s: float = 1 / 15,
    boxes: np.ndarray = NO_BOXES,
    back_at: int = 10**9,
    config: HealthConfig | None = None,
) -> list[Parts]:
    """The clock is set back by an hour before picture number ``back_at``."""
    monitor, previous, states = PartsMonitor(config or HealthConfig()), None, []
    for number, picture in enumerate(pictures):
        grey = reduce(picture)
        stamp_s = number * period_s - 3600.0 * (number >= back_at)
        states.append(monitor.update(START_NS + round(stamp_s * 1e9), grey, previous, boxes, 0.4))
        previous = grey
    return states


SEES, BLIND = True, False


@pytest.mark.parametrize(
    ("fault", "pictures", "period_s", "sees", "reason"),
    [
        (sticker(1.0), 18, 1.0, [SEES] * 3 + [BLIND] * 2 + [SEES] * 3, "something on the lens"),
        (sticker(12.0), 18, 1.0, [SEES] * 3 + [BLIND] * 2 + [SEES] * 3, "something on the lens"),
        (lower(160, (0, 135, 0)), 6, 1 / 15, [BLIND] * 8, "no picture there"),
        (lower(240, (128, 128, 128)), 6, 1 / 15, None, "no picture there"),
        (lower(240, None), 6, 1 / 15, None, "no picture there"),
        (left_half_frozen, 24, 1 / 15, [BLIND] * 4 + [SEES] * 4, "the picture stands still there"),
        (rolling_bands, 10, 1 / 15, [SEES] * 8, "bands roll over the picture"),
    ],
)
def test_a_part_that_does_not_see_is_told(
    texture: np.ndarray, fault: Fault, pictures: int, period_s: float, sees: list[bool] | None, reason: str
) -> None:
    state = shown((fault(texture, number) for number in range(pictures)), period_s)[-1]
    assert reason in state.reason
    assert list(state.sees) == sees or (sees is None and state.blind_ahead)


@pytest.mark.parametrize(("fault", "period_s"), [(sticker(1.0), 1.0), (left_half_frozen, 1 / 15)])
@pytest.mark.parametrize("back_at", [5, 24])
def test_a_clock_that_is_set_back_hides_no_blind_part(
    texture: np.ndarray, fault: Fault, period_s: float, back_at: int
) -> None:
    """Neither one that is about to be told, nor one that was: it counted as seeing until the hour was over."""
    states = shown((fault(texture, number) for number in range(34)), period_s, back_at=back_at)
    assert states[23].blind_ahead
    assert states[-1].blind_ahead


def test_it_clears_when_the_fault_goes(texture: np.ndarray) -> None:
    broken = lower(160, (0, 135, 0))
    states = shown(broken(texture, n) if n < 10 else noisy(texture, n) for n in range(20))
    assert states[9].blind_ahead
    assert states[-1] == Parts((True,) * 8, "", False)


@pytest.mark.parametrize("scenario", ["crossing", "drive", "empty"])
def test_the_simulated_world_is_a_view(scenario: str) -> None:
    """Twice a second for 25 s: people, cars that fill the picture, plain walls."""
    states = shown((simulated.image(scenario, t / 2) for t in range(50)), 0.5)
    assert {state.reason for state in states} == {""}


@pytest.mark.parametrize("first_s", [10.85, 13.55])
def test_a_car_that_passes_between_two_looks_is_no_band_that_rolls(first_s: float) -> None:
    """Looks are 0.6 s apart and told at once: two pictures are no evidence of bands, whatever ``raise_frames`` is."""
    at_once = HealthConfig(raise_frames=1)
    pictures = [simulated.image("crossing", first_s + 0.6 * look) for look in range(3)]
    first, second = (cv2.resize(reduce(picture), (320, 240)).astype(np.float32) for picture in pictures[:2])
    assert bands(second, first) > at_once.bands_above
    assert {state.reason for state in shown(iter(pictures), 0.6, config=at_once)} == {""}


def test_a_box_of_the_network_explains_a_plain_part(texture: np.ndarray) -> None:
    """A car's side that fills the middle is plain as well, but the network knows what it is."""
    pictures = [sticker(1.0)(texture, number) for number in range(18)]
    assert shown(iter(pictures), 1.0)[-1].blind_ahead
    assert not shown(iter(pictures), 1.0, np.array([[0.25, 0.25, 0.75, 0.75]]))[-1].blind_ahead


def test_small_pictures_are_not_judged(texture: np.ndarray) -> None:
    assert shown(iter([texture[:40, :60]] * 3))[-1] == Parts((), "", False)


def test_a_blind_forward_zone_is_degraded_and_covers_nothing() -> None:
    pipeline = CameraPipeline(fitted(CameraConfig(source="sim:crossing")))
    seen = pipeline.process(0, simulated.image("empty", 0.0))
    assert (seen.state, seen.strips_see) == ("online", (True,) * 8)
    assert seen.cover is not None
    assert seen.cover.why == ""
    for number in range(1, 7):
        image = simulated.image("empty", number / 15)
        image[200:] = (0, 135, 0)
        seen = pipeline.process(number * 66_666_667, image)
    assert seen.state == "degraded"
    assert seen.reason.startswith("blind from 0 % to 100 %")
    assert seen.strips_see == (False,) * 8
    assert seen.cover is not None
    assert seen.cover.why == seen.reason


@pytest.mark.parametrize(("source", "after_s"), [("file:drive.mp4", 0.0), ("csi:0", 1.0)])
def test_a_compressed_video_may_keep_parts_that_do_not_move(source: str, after_s: float) -> None:
    config = msgspec.structs.replace(CameraConfig(), source=source)
    assert fitted(config).health.part_frozen_after_s == after_s
