"""HTTP with a limit on the patience: whoever connects and does not ask within some seconds is let go.

Otherwise connections that say nothing, or a byte of a header now and then (slowloris), use up the file descriptors.
"""

from __future__ import annotations

import asyncio
from functools import partial
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

END_OF_HEADERS = b"\r\n\r\n"


class ImpatientProtocol(H11Protocol):
    """As uvicorn's own, closed when a request is not complete ``request_within_s`` after it could begin, or began."""

    def __init__(self, *arguments: Any, request_within_s: float, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self._request_within_s = request_within_s
        self._beginning = b""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._set_deadline()

    def _set_deadline(self) -> None:
        self._beginning = b""
        self._deadline = asyncio.get_running_loop().call_later(self._request_within_s, self.transport.close)

    def data_received(self, data: bytes) -> None:
        if self._deadline.cancelled() and self.cycle is not None and self.cycle.response_complete:
            self._set_deadline()  # another request begins: from now on uvicorn itself waits for ever
        if not self._deadline.cancelled():
            self._beginning = (self._beginning + data)[-(len(END_OF_HEADERS) - 1 + len(data)) :]
            if END_OF_HEADERS in self._beginning:
                self._deadline.cancel()
        super().data_received(data)

    def connection_lost(self, exc: Exception | None) -> None:
        self._deadline.cancel()
        super().connection_lost(exc)


def impatient(request_within_s: float) -> Any:
    """For ``uvicorn.Config(http=...)``, which calls it with arguments of its own."""
    return partial(ImpatientProtocol, request_within_s=request_within_s)
