"""The newest of everything, and the short histories that the page draws. Pure: time comes in as an argument."""

from __future__ import annotations

import logging
import threading
from collections import deque
from dataclasses import dataclass
from typing import Any

import msgspec

from common.codec import to_builtins
from common.messages import CompressedImage, Message, SystemHealth, Verdict

log = logging.getLogger("dashboard")

HISTORY = 300
PICTURES = 16  # of each camera: a picture is asked for after its message was seen, over a slow link seconds later
_ENCODER = msgspec.json.Encoder()


@dataclass
class Entry:
    """The newest message of one key; its JSON is made once, however many clients look."""

    message: Message
    arrived_s: float
    encoded: msgspec.Raw | None = None

    def json(self) -> msgspec.Raw:
        """The message as JSON, encoded once."""
        if self.encoded is None:
            self.encoded = msgspec.Raw(_ENCODER.encode(to_builtins(self.message)))
        return self.encoded


class Board:
    """Thread-safe: one thread puts messages up, the server's clients read."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._entries: dict[str, Entry] = {}
        self._verdicts: deque[dict[str, Any]] = deque(maxlen=HISTORY)
        self._healths: deque[dict[str, Any]] = deque(maxlen=HISTORY)
        self._states: dict[str, tuple[str, str]] = {}
        self._pictures: dict[str, deque[CompressedImage]] = {}
        self._not_shown: set[str] = set()  # keys of which that is in the log

    def put(self, key: str, message: Message, arrived_s: float) -> None:
        """Hang up a message; changes of verdict and of sensor states go into the histories."""
        with self._lock:
            self._entries[key] = Entry(message, arrived_s)
            if isinstance(message, Verdict):
                self._note_verdict(message)
            elif isinstance(message, SystemHealth):
                self._note_health(message)
            elif isinstance(message, CompressedImage):
                self._pictures.setdefault(key, deque(maxlen=PICTURES)).append(message)

    def image(self, key: str, stamp_ns: int | None = None) -> bytes | None:
        """A JPEG of a camera topic: the one with this stamp while it is kept; without a stamp the newest."""
        with self._lock:
            kept = reversed(self._pictures.get(key, ()))
            return next((one.data for one in kept if stamp_ns in (None, one.stamp_ns)), None)

    def newest(self, suffix: str, now_s: float) -> list[tuple[str, Message, float]]:
        """(key, message, age in seconds) of every key that ends so, in the order of the keys."""
        with self._lock:
            found = [(key, entry) for key, entry in self._entries.items() if key.endswith(suffix)]
        return [(key, entry.message, now_s - entry.arrived_s) for key, entry in sorted(found, key=lambda one: one[0])]

    def snapshot(self, now_s: float, now_ns: int, products: set[str]) -> bytes:
        """JSON with the newest messages of these products (``"*"`` = all but pictures) and their ages in ms.

        now_ns: UTC of this host, beside which the stamps of the histories are read: a viewer's clock may be wrong.
        """
        with self._lock:
            entries = {
                key: {"age_ms": round(1e3 * (now_s - entry.arrived_s), 1), "message": content}
                for key, entry in self._entries.items()
                if (
                    "*" in products
                    or key.split("/", 1)[1] in products
                    or key.endswith(("/status", "/health", "/verdict"))
                )
                and (content := self._content_or_none(key, entry)) is not None
            }
            verdicts, healths = list(self._verdicts)[-100:], list(self._healths)[-100:]
            return _ENCODER.encode({"stamp_ns": now_ns, "entries": entries, "verdicts": verdicts, "healths": healths})

    def _content_or_none(self, key: str, entry: Entry) -> msgspec.Raw | None:
        """None where a free-form field holds what JSON has no word for: the page then lacks this message alone."""
        try:
            return self._content(key, entry)
        except (TypeError, ValueError, RuntimeError) as error:
            if key not in self._not_shown:
                self._not_shown.add(key)
                log.warning("%s cannot be shown as JSON: %s", key, error)
            return None

    def _content(self, key: str, entry: Entry) -> msgspec.Raw:
        """A picture is fetched on its own, at its address; what is written in it is here.

        The address is made here because JavaScript's numbers cannot hold a stamp: they would name another picture.
        """
        if not isinstance(entry.message, CompressedImage):
            return entry.json()
        content = {name: value for name, value in to_builtins(entry.message).items() if name != "data"}
        content["address"] = f"/api/image/{key.partition('/')[0]}?stamp={entry.message.stamp_ns}"
        return msgspec.Raw(_ENCODER.encode(content))

    def _note_verdict(self, verdict: Verdict) -> None:
        last = self._verdicts[-1] if self._verdicts else {}
        if (last.get("level"), last.get("rule")) != (verdict.level, verdict.rule):
            self._verdicts.append(
                {
                    "stamp_ns": verdict.stamp_ns,
                    "level": verdict.level,
                    "rule": verdict.rule,
                    "because": verdict.because,
                    "permission": verdict.permission,
                }
            )

    def _note_health(self, system: SystemHealth) -> None:
        for name, sensor in system.sensors.items():
            if self._states.get(name, ("", ""))[0] != sensor.state:
                self._states[name] = (sensor.state, sensor.reason)
                self._healths.append(
                    {"stamp_ns": system.stamp_ns, "sensor": name, "state": sensor.state, "reason": sensor.reason}
                )
