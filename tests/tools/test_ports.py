"""Free ports: nobody's, and not those that the system gives to any outgoing connection."""

import socket

import pytest

from spotter_tools import ports


def test_a_port_is_below_those_of_outgoing_connections():
    with socket.create_server(("127.0.0.1", 0)) as server, socket.create_connection(server.getsockname()) as outgoing:
        given = [ports.free_port() for _ in range(50)]
        assert max(given) < outgoing.getsockname()[1]
    assert min(given) >= ports.FIRST_PORT
    assert len(set(given)) > 40


@pytest.mark.parametrize("text", [None, "", "many"])
def test_where_the_system_does_not_say_which_these_are_the_usual_ones_are_meant(monkeypatch, tmp_path, text):
    file = tmp_path / "range"
    if text is not None:
        file.write_text(text)
    monkeypatch.setattr(ports, "OUTGOING_PORTS", file)
    assert ports.FIRST_PORT <= ports.free_port() < ports.USUAL_FIRST_OUTGOING_PORT


def test_a_port_that_somebody_has_is_not_given(monkeypatch):
    taken, free = ports.free_port(), ports.free_port()
    with socket.create_server(("127.0.0.1", taken)):
        monkeypatch.setattr(ports, "_RANDOM", _Given([taken, taken, free]))
        assert ports.free_port() == free
        monkeypatch.setattr(ports, "_RANDOM", _Given([taken] * ports.TRIES))
        with pytest.raises(OSError, match="in use"):
            ports.free_port()


class _Given:
    def __init__(self, numbers):
        self._numbers = iter(numbers)

    def randint(self, low, high):
        return next(self._numbers)
