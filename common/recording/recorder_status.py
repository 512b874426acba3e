"""A recorder\'s token and status on the bus, like those of a service, so that dashboard and `spotter top` show it.

Where access rules are in force, a laptop may publish under its certificate's name only, a host's own session under the
host's name. Zenoh does not report a refused put, so a second session subscribes to check that the status arrives.
"""

from __future__ import annotations

import re
import socket
import threading
import uuid
from pathlib import Path

import zenoh

from common.bus.status import ENDED, Report
from common.clock import utc_ns
from common.codec import encode_for_readers, encoding_of
from common.messages import ServiceState, ServiceStatus
from common.recording.recorder import RecorderStatus
from common.topics import RECORDER, status_topic, token_key

TRIES = 3  # statuses without an echo after which the rules are taken to refuse them


class RecorderPresence:
    """Token and status ``<host>/recorder/status``; ``report`` publishes the recorder's numbers, about once a second."""

    def __init__(self, session: zenoh.Session, host: str, witness: zenoh.Session) -> None:
        """``witness``: another session at the same router; a session always receives its own messages."""
        instance = uuid.uuid4().hex[:8]
        self._session, self._key = session, status_topic(RECORDER).key(host)
        self._report, self._seq, self._lost = Report(instance), 0, 0
        self._token = session.liveliness().declare_token(token_key(host, RECORDER, instance))
        self._word = b""
        self._answers = session.declare_queryable(self._key, self._answer)
        self._echo = threading.Event()
        self._witness = witness.declare_subscriber(self._key, lambda _: self._echo.set())

    @property
    def refused(self) -> bool:
        """Several statuses were sent, and the router forwarded none of them."""
        return self._seq >= TRIES and not self._echo.is_set()

    def report(self, status: RecorderStatus) -> None:
        """Publish what is being recorded; degraded once messages were lost."""
        self._report.dropped(status.dropped - self._lost)
        self._lost = status.dropped
        self._publish("degraded" if status.dropped else "online", self.words(status), status)

    def end(self, status: RecorderStatus, failed: str = "") -> None:
        """The last status of a recorder that was stopped: without it, it would look lost. ``failed``: why by itself."""
        if failed:
            self._publish("degraded", failed, status)
        else:
            self._publish("online", f"{ENDED}{self.words(status)}", status)

    def _publish(self, state: ServiceState, reason: str, status: RecorderStatus) -> None:
        self._report.state(state, reason)
        message = self._report.snapshot()
        message.seq, message.sent_ns, message.published = self._seq, utc_ns(), status.messages
        self._word = encode_for_readers(message)[0]
        # No declared publisher: it waits for the declarations of subscribers, which a laptop's rules do not let in.
        self._session.put(self._key, self._word, encoding=encoding_of(ServiceStatus))
        self._seq += 1

    def _answer(self, query: zenoh.Query) -> None:
        """Answer `spotter ls`; before the first second there is no status."""
        with query:
            if self._word:
                query.reply(self._key, self._word, encoding=encoding_of(ServiceStatus))

    @staticmethod
    def words(status: RecorderStatus) -> str:
        """For people: file, messages, megabytes, losses, free disk space."""
        return (
            f"{Path(status.file).name}: {status.messages} messages, {status.bytes / 1e6:.1f} MB, "
            f"{status.dropped} dropped, {status.free_bytes / 1e9:.0f} GB free"
        )


def this_machine() -> str:
    """The machine's host name, as a valid part of a key."""
    return re.sub(r"[^a-z0-9_]", "_", socket.gethostname().lower()) or "laptop"
