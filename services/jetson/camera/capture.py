"""Pictures of a live camera: its child process watched, replaced when it is lost, waited for when it is slow."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Iterator
from pathlib import Path

from common.backoff import Backoff
from common.bus.status import Report
from common.clock import monotonic_s
from common.source_url import SourceUrl
from services.jetson.camera.child import CaptureChild, CaptureLost, CaptureSilent
from services.jetson.camera.config import CaptureConfig
from services.jetson.camera.frames import Frame
from services.jetson.camera.gstreamer import advice, command, device_path, picture_size

log = logging.getLogger("source")

FEW_PICTURES = 3  # a child that is silent so soon after its start may be slow
QUICK_PICTURES = 30  # in a row: a camera that was slow no longer is
TOO_SLOW = "it may be too slow: more light, a smaller picture, or a larger [capture] frame_timeout_s; if it hangs,"
RESTATE_S = 0.2  # how often a lost camera is said to be lost while nothing else happens


class Patience:
    """How long a child may be silent between two pictures; longer for a camera that has shown to be slow.

    A child that falls silent after its first pictures may only be slow, and to replace it would never give more than
    those. Each time it happens the next child is given twice as long, up to the time for a first picture.
    """

    def __init__(self, config: CaptureConfig) -> None:
        self._least_s, self._most_s = config.frame_timeout_s, config.start_timeout_s
        self.timeout_s = self._least_s
        self._pictures = self._quick = 0

    def started(self) -> None:
        """A new child."""
        self._pictures = self._quick = 0

    def picture(self, after_s: float) -> None:
        """It came so long after the one before."""
        self._pictures += 1
        self._quick = self._quick + 1 if after_s < self._least_s else 0
        if self._quick >= QUICK_PICTURES:
            self.timeout_s = self._least_s

    def silent(self) -> bool:
        """It was silent for the whole time: is it perhaps only slow?"""
        slow = 0 < self._pictures <= FEW_PICTURES or (self._pictures > 0 and self.timeout_s > self._least_s)
        if slow:
            self.timeout_s = max(min(2 * self.timeout_s, self._most_s), self._least_s)
        return slow


def captured(url: SourceUrl, config: CaptureConfig, report: Report, stop: threading.Event) -> Iterator[Frame]:
    """Frames of a child process; a child that ends or hangs is replaced, with a growing pause between attempts."""
    backoff, patience = Backoff(config.retry_min_s, config.retry_max_s), Patience(config)
    while not stop.is_set():
        trouble = _obstacle(url, config)
        if trouble is None:
            try:
                with CaptureChild(command(url, config), *picture_size(url, config)) as child:
                    for frame in _pictures(child, url, (config, patience), report, stop):
                        backoff.reset()
                        yield frame
                return
            except CaptureLost as error:
                trouble = str(error)
        pause_s = backoff.next_s()
        log.warning("%s: %s; next attempt in %.1f s", url, trouble, pause_s)
        _wait_lost(f"{url}: {trouble}", pause_s, report, stop)


def _pictures(
    child: CaptureChild, url: SourceUrl, limits: tuple[CaptureConfig, Patience], report: Report, stop: threading.Event
) -> Iterator[Frame]:
    """Frames of one child until it is lost, which is told before the child is cleared away."""
    config, patience = limits
    timeout_s, last_s = config.start_timeout_s, monotonic_s()
    patience.started()
    while not stop.is_set():
        try:
            frame = child.read(timeout_s)
        except CaptureLost as error:
            slow = isinstance(error, CaptureSilent) and patience.silent()
            lost = CaptureLost(f"{error}; {f'{TOO_SLOW} ' if slow else ''}{advice(url)}")
            report.state("disconnected", f"{url}: {lost}")
            raise lost from None
        now_s = monotonic_s()
        patience.picture(now_s - last_s)
        last_s = now_s
        yield frame
        timeout_s = patience.timeout_s


def _wait_lost(reason: str, pause_s: float, report: Report, stop: threading.Event) -> None:
    """Say it again and again: a frame that was still being processed may have said "online" in between."""
    until_s = monotonic_s() + pause_s
    while True:
        report.state("disconnected", reason)
        left_s = until_s - monotonic_s()
        if left_s <= 0 or stop.wait(min(left_s, RESTATE_S)):
            return


def _obstacle(url: SourceUrl, config: CaptureConfig) -> str | None:
    """Why an attempt is not worth it, told apart: no device, or no permission."""
    path = Path(device_path(url))
    if url.scheme != "v4l2" or config.v4l2_command:
        return None
    if not path.exists():
        return f"{path} is not there; plug the camera in"
    if not os.access(path, os.R_OK | os.W_OK):
        return f"{path} may not be read by this user; add the user to the group video"
    return None
