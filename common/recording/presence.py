"""A recorder makes itself known on the bus like a service: the dashboard and `spotter top` show that it runs.

Where access rules are in force a laptop may say so under its certificate's name only, a host's own session under the
host's. Zenoh tells no writer that it was refused, so a second session listens whether the word gets through.
"""

from __future__ import annotations

import re
import socket
import threading
import uuid
from pathlib import Path

import zenoh

from common.clock import utc_ns
from common.codec import encode, encoding_of
from common.messages import ServiceStatus
from common.recording.recorder import RecorderStatus
from common.status import Report
from common.topics import RECORDER, status_topic, token_key

TRIES = 3  # statuses after which a word that nobody passed on counts as refused


class RecorderPresence:
    """Token and status ``<host>/recorder/status``; ``tell`` it the recorder's numbers about once a second."""

    def __init__(self, session: zenoh.Session, host: str, witness: zenoh.Session) -> None:
        """``witness``: another session at the same router; a session always hears itself."""
        instance = uuid.uuid4().hex[:8]
        self._session, self._key = session, status_topic(RECORDER).key(host)
        self._report, self._seq, self._lost = Report(instance), 0, 0
        self._token = session.liveliness().declare_token(token_key(host, RECORDER, instance))
        self._word = b""
        self._answers = session.declare_queryable(self._key, self._answer)
        self._heard = threading.Event()
        self._witness = witness.declare_subscriber(self._key, lambda _: self._heard.set())

    @property
    def refused(self) -> bool:
        """It has told several times, and the router passed none of it on."""
        return self._seq >= TRIES and not self._heard.is_set()

    def tell(self, status: RecorderStatus) -> None:
        """Publish what is being recorded; degraded once messages were lost."""
        self._report.dropped(status.dropped - self._lost)
        self._lost = status.dropped
        self._report.state("degraded" if status.dropped else "online", self.words(status))
        message = self._report.snapshot()
        message.seq, message.sent_ns, message.published = self._seq, utc_ns(), status.messages
        self._word = encode(message)
        # No declared publisher: that one waits to be told of listeners, which a laptop's rules do not let in.
        self._session.put(self._key, self._word, encoding=encoding_of(ServiceStatus))
        self._seq += 1

    def _answer(self, query: zenoh.Query) -> None:
        """`spotter ls` asks; before the first second nobody knows anything."""
        with query:
            if self._word:
                query.reply(self._key, self._word, encoding=encoding_of(ServiceStatus))

    @staticmethod
    def words(status: RecorderStatus) -> str:
        """For a person: file, messages, megabytes, lost, and what is left of the disk."""
        return (
            f"{Path(status.file).name}: {status.messages} messages, {status.bytes / 1e6:.1f} MB, "
            f"{status.dropped} dropped, {status.free_bytes / 1e9:.0f} GB free"
        )


def this_machine() -> str:
    """The machine's own name, fit for a key."""
    return re.sub(r"[^a-z0-9_]", "_", socket.gethostname().lower()) or "laptop"
