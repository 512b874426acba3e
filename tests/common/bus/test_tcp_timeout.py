"""The kernel's option is set on the connections of this process, and nothing else minds."""

from __future__ import annotations

import socket

from common.bus.tcp_timeout import set_tcp_user_timeout


def test_every_connection_is_given_up_after_that_time() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server, socket.create_connection(server.getsockname()) as client:
        accepted, _ = server.accept()
        with accepted, socket.socket(socket.AF_UNIX) as other:
            set_tcp_user_timeout(2.0)
            for connection in (client, accepted):
                assert connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) == 2000
            assert other.fileno() >= 0
