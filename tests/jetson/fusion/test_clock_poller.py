"""The thread that asks the services for the time: a question that fails is asked again, until the session is closed."""

import threading
from collections.abc import Callable
from types import SimpleNamespace

import pytest
import zenoh

from services.jetson.fusion import source
from services.jetson.fusion.clocks import ClockSample
from services.jetson.fusion.config import ClocksConfig, FusionConfig


def test_a_question_that_fails_once_does_not_end_the_measuring(
    monkeypatch: pytest.MonkeyPatch, until: Callable[..., None]
) -> None:
    closed, failures = threading.Event(), iter([True, True, True])

    def ask(session: object, host: str, service: str) -> ClockSample | None:
        if next(failures, False):
            raise zenoh.ZError("no buffer")
        return ClockSample(service, 0.0, 0.0, 0.0)

    monkeypatch.setattr(source, "ask", ask)
    monkeypatch.setattr(source, "ask_router", lambda *_: {})
    service = SimpleNamespace(session=SimpleNamespace(is_closed=closed.is_set), wake=threading.Event())
    presence = SimpleNamespace(instances=lambda *_: {"a1"})
    before = set(threading.enumerate())
    poller = source.ClockPoller(service, presence, FusionConfig(clocks=ClocksConfig(period_s=0.1)))  # type: ignore[arg-type]
    (thread,) = set(threading.enumerate()) - before
    until(lambda: bool(poller.take()))
    closed.set()
    until(lambda: not thread.is_alive())
