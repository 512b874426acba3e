"""The newest of everything, and the short histories that the page draws. Pure: time comes in as an argument."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from typing import Any

import msgspec

from common.codec import to_builtins
from common.messages import CompressedImage, Message, SystemHealth, Verdict

HISTORY = 300
_ENCODER = msgspec.json.Encoder()


@dataclass
class Entry:
    """The newest message of one key; its JSON is made once, however many clients look."""

    message: Message
    arrived_s: float
    encoded: msgspec.Raw | None = None

    def json(self) -> msgspec.Raw:
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

    def put(self, key: str, message: Message, arrived_s: float) -> None:
        """Hang up a message; changes of verdict and of sensor states go into the histories."""
        with self._lock:
            self._entries[key] = Entry(message, arrived_s)
            if isinstance(message, Verdict):
                self._note_verdict(message)
            elif isinstance(message, SystemHealth):
                self._note_health(message)

    def image(self, key: str) -> bytes | None:
        """The newest JPEG of a camera topic."""
        with self._lock:
            entry = self._entries.get(key)
        return entry.message.data if entry and isinstance(entry.message, CompressedImage) else None

    def snapshot(self, now_s: float, products: set[str]) -> bytes:
        """JSON with the newest messages of these products (``"*"`` = all but pictures) and their ages in ms."""
        with self._lock:
            entries = {
                key: {"age_ms": round(1e3 * (now_s - entry.arrived_s), 1), "message": self._content(entry)}
                for key, entry in self._entries.items()
                if "*" in products
                or key.split("/", 1)[1] in products
                or key.endswith(("/status", "/health", "/verdict"))
            }
            return _ENCODER.encode(
                {"entries": entries, "verdicts": list(self._verdicts)[-100:], "healths": list(self._healths)[-100:]}
            )

    @staticmethod
    def _content(entry: Entry) -> msgspec.Raw:
        if isinstance(entry.message, CompressedImage):  # fetched on its own, by seq
            return msgspec.Raw(_ENCODER.encode({"seq": entry.message.seq, "stamp_ns": entry.message.stamp_ns}))
        return entry.json()

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
