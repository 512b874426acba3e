"""Pictures from a child process that writes raw BGR rows to its stdout, with a watchdog.

The camera's driver stack lives in the child: when it hangs, the child is killed, not this service. PyPI's OpenCV has
no GStreamer, so the child is ``gst-launch-1.0``; any command that writes frames of the agreed size will do.
"""

from __future__ import annotations

import fcntl
import os
import selectors
import shutil
import subprocess
from types import TracebackType

import numpy as np

from common.clock import monotonic_s, utc_ns
from services.jetson.camera.frames import Frame

_PIPE_BYTES = 1 << 20  # the most an unprivileged process may ask for
_STOP_TIMEOUT_S = 0.3
_STDERR_KEPT = 4000


class CaptureLost(OSError):
    """The child has ended, or has been silent for too long; the text says which and what it said last."""


class CaptureSilent(CaptureLost):
    """The child runs, and has been silent for too long."""


class CaptureChild:
    """One run of the child. ``read`` returns the next frame; leaving the ``with`` ends the child for certain."""

    def __init__(self, command: list[str], width_px: int, height_px: int) -> None:
        self._command = command
        self._shape = (height_px, width_px, 3)
        self._stderr = b""
        self._selector = selectors.DefaultSelector()

    def __enter__(self) -> CaptureChild:
        if shutil.which(self._command[0]) is None:
            raise CaptureLost(f"{self._command[0]} is not installed")
        self._process = subprocess.Popen(
            _bound_to_us(self._command),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C is for the service, which then ends the child itself
            bufsize=0,
        )
        assert self._process.stdout is not None
        assert self._process.stderr is not None
        self._out, self._err = self._process.stdout.fileno(), self._process.stderr.fileno()
        fcntl.fcntl(self._out, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
        for descriptor in (self._out, self._err):
            os.set_blocking(descriptor, False)
            self._selector.register(descriptor, selectors.EVENT_READ)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._selector.close()
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(_STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                self._process.kill()  # also ends a process that is stopped
                self._process.wait()
        for pipe in (self._process.stdout, self._process.stderr):
            if pipe is not None:
                pipe.close()

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def read(self, timeout_s: float) -> Frame:
        """The next whole frame, stamped when its first byte came.

        Raises:
            CaptureLost: the child ended, or no whole frame came within ``timeout_s``.
        """
        image = np.empty(self._shape, np.uint8)
        missing = image.reshape(-1).data
        deadline_s = monotonic_s() + timeout_s
        stamp_ns = 0
        while len(missing):
            self._wait_readable(deadline_s, timeout_s)
            try:
                got = os.readv(self._out, [missing])
            except BlockingIOError:
                continue  # it was stderr that had something to say
            if got == 0:
                raise CaptureLost(self._how_it_ended())
            stamp_ns = stamp_ns or utc_ns()
            missing = missing[got:]
        return Frame(stamp_ns, utc_ns(), image)

    def _wait_readable(self, deadline_s: float, timeout_s: float) -> None:
        left_s = deadline_s - monotonic_s()
        ready = self._selector.select(left_s) if left_s > 0 else []
        if not ready:
            raise CaptureSilent(f"no whole picture for {timeout_s:g} s{self._last_words()}")
        if any(key.fd == self._err for key, _ in ready):
            self._read_stderr()

    def _read_stderr(self) -> None:
        try:
            text = os.read(self._err, 65536)
        except BlockingIOError:  # the child has ended, and what it started keeps its stderr open in silence
            return
        if not text:
            self._selector.unregister(self._err)
        self._stderr = (self._stderr + text)[-_STDERR_KEPT:]

    def _how_it_ended(self) -> str:
        try:
            code = self._process.wait(_STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            return f"the capture process closed its output{self._last_words()}"
        if self._err in self._selector.get_map():
            self._read_stderr()
        how = f"was killed by signal {-code}" if code < 0 else f"ended with code {code}"
        return f"the capture process {how}{self._last_words()}"

    def _last_words(self) -> str:
        lines = self._stderr.decode(errors="replace").split("\n")
        errors = [line.strip() for line in lines if "ERROR" in line] or [line.strip() for line in lines if line.strip()]
        return f": {errors[0][:200]}" if errors else ""


def _bound_to_us(command: list[str]) -> list[str]:
    """The child dies with us even when we are killed: a hung one would keep the camera from our successor."""
    setpriv = shutil.which("setpriv")  # util-linux; it becomes the command, so the process id stays
    return [setpriv, "--pdeathsig", "KILL", "--", *command] if setpriv else command
