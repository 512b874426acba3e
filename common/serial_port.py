"""Error texts for a serial port, with what to do."""

from __future__ import annotations

import errno
import os
import termios

PORT_ERRORS = (OSError, termios.error)
"""Of a serial port. Pyserial's own are ``OSError``; ``termios.error`` is of one that is lost while it is set up."""


def explain(port: str, error: Exception, was_open: bool) -> str:
    """The reason for an error of opening or reading ``port``; ``was_open`` = it has worked before."""
    number = getattr(error, "errno", None)
    cause = error if isinstance(error, termios.error) else error.__context__  # pyserial keeps only the text of it
    if number is None and isinstance(cause, termios.error):
        number = cause.args[0]
    if number == errno.ENOENT and was_open:
        return f"{port} is gone: unplugged? Waiting for it to come back"
    if number == errno.ENOENT:
        return f"{port} does not exist yet: plug the device in or correct the path. Waiting for it"
    if number in (errno.EACCES, errno.EPERM):
        user = os.environ.get("USER", "the service's user")
        return f"{port}: permission denied: add {user} to the group that owns it (usually dialout) and log in again"
    if number in (errno.EBUSY, errno.EAGAIN):
        return f"{port} is in use by another process: stop it (a login console or ModemManager, perhaps)"
    if number in (errno.ENOTTY, errno.EINVAL, errno.EISDIR):
        return f"{port} is no serial port: correct the path"
    if was_open:
        return f"{port}: lost while reading: unplugged? Waiting for it to come back ({error})"
    return f"{port}: cannot be opened: {error}"
