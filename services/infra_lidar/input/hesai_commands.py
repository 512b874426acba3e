"""Ask a Hesai sensor for its calibration, by the vendor's TCP commands. Opens a socket.

User manual, "Communication protocol" (PTC): a command is 0x47 0x74, its number, a return code and the length of what
follows, big endian; the answer has the same head. Numbers 5 (angle correction) and 0xA9 (firing times, QT128) as in the
manual and the vendor's SDK; a sensor that does not know a command answers with a return code other than 0.
"""

from __future__ import annotations

import socket
import struct

from services.infra_lidar.input.hesai_calibration import CalibrationError, as_metadata, read_calibration

COMMAND_PORT = 9347
TIMEOUT_S = 5.0
ANGLES, FIRETIMES = 0x05, 0xA9
MAX_ANSWER_BYTES = 1 << 20
_HEAD = struct.Struct(">2sBBI")
_START = b"\x47\x74"


def ask_calibration(host: str, port: int = COMMAND_PORT) -> str:
    """Metadata of a sensor, see ``hesai_calibration.as_metadata``.

    Raises:
        OSError: it does not answer.
        CalibrationError: it answers with something else.
    """
    if not host:
        raise CalibrationError("no address to ask")
    with socket.create_connection((host, port), TIMEOUT_S) as connection:
        angles = _ask(connection, ANGLES)
        times = _ask(connection, FIRETIMES)
    if angles is None:
        raise CalibrationError("the sensor refuses the command for its angle correction")
    read_calibration(angles)
    try:
        read_calibration(angles, times or "")
    except CalibrationError:
        times = None  # some models answer this command with something else
    return as_metadata(angles, times or "")


def _ask(connection: socket.socket, command: int) -> str | None:
    """What the sensor answers to a command without arguments; None if it refuses it."""
    connection.sendall(_HEAD.pack(_START, command, 0, 0))
    start, answered, code, length = _HEAD.unpack(_receive(connection, _HEAD.size))
    if start != _START or answered != command or length > MAX_ANSWER_BYTES:
        raise CalibrationError("the answer on the command port is not that of a Hesai sensor")
    body = _receive(connection, length)
    return body.decode("utf-8-sig", "replace").strip("\0") if code == 0 and body else None


def _receive(connection: socket.socket, count: int) -> bytes:
    parts = bytearray()
    while len(parts) < count:
        part = connection.recv(count - len(parts))
        if not part:
            raise ConnectionError("the sensor has closed the connection")
        parts += part
    return bytes(parts)
