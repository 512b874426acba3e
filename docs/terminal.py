"""Takes the terminal picture of the bring-up again: docs/bring-up/setup.svg.

    python docs/terminal.py

On a machine with two pseudo-terminals (an LD06 and a GPS receiver, both simulated byte for byte) and a video file as
devices: `spotter setup`, `spotter up`, `spotter ls`, `spotter health`, typed at a real terminal. Needs the extras
``jetson`` and ``laptop``, the default ports free, and about half a minute.
"""

from __future__ import annotations

import contextlib
import inspect
import os
import pty
import re
import select
import shutil
import signal
import sys
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
from rich.console import Console
from rich.text import Text

from services.jetson.camera.detector import DEMO_MODEL
from spotter_sim import camera, ld06

PICTURE = Path(__file__).parent / "bring-up" / "setup.svg"
BENCH = Path("/tmp/bench")
COLUMNS = 132
PROMPT = "$ "
BINARIES = Path(sys.executable).parent


def main() -> None:
    """The command above."""
    lay_out(BENCH)
    environment = {**os.environ, "PATH": f"{BINARIES}:{os.environ['PATH']}", "TERM": "dumb", "PS1": PROMPT}
    environment["COLUMNS"] = str(COLUMNS)
    shell = Shell(environment)
    shell.read_until(PROMPT)
    shell.enter("spotter setup jetson0 --dev dev --open", "source of lidar")
    shell.enter("", "source of camera")
    shell.enter("", PROMPT)
    shell.enter("spotter up jetson0 --site site.toml 2> up.log &", PROMPT)
    log = BENCH / "up.log"
    wait_for(lambda: log.exists() and "camera" in log.read_text())
    time.sleep(8.0)  # until every sensor that is there has come online
    shell.enter("spotter ls", PROMPT)
    shell.enter("spotter health", PROMPT)
    shell.close()
    save(shell.text)


def lay_out(bench: Path) -> None:
    """The devices of the bench, below a folder like /dev, and a network beside the site file to be."""
    shutil.rmtree(bench, ignore_errors=True)
    (bench / "dev/serial/by-id").mkdir(parents=True)
    by_id = bench / "dev/serial/by-id"
    (by_id / "usb-Silicon_Labs_CP2102N_LD06-if00-port0").symlink_to(
        plugged(lambda t_s: ld06.packets("crossing", t_s, t_s + 0.02))
    )
    (bench / "dev/ttyUSB1").symlink_to(plugged(lambda _: b"$GPGGA,123519,4807.038,N,01131.000,E,1,08*47\r\n"))
    video = cv2.VideoWriter(str(bench / "street.mp4"), cv2.VideoWriter_fourcc(*"mp4v"), 15, (640, 480))
    for i in range(60):
        video.write(camera.image("crossing", i / 15, 640, 480))
    video.release()
    (bench / "dev/video0").symlink_to(bench / "street.mp4")
    shutil.copy(DEMO_MODEL, bench / "street.onnx")


def plugged(says: Callable[[float], bytes]) -> str:
    """The path of a serial port whose device says this for every 20 ms."""
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)

    def speak() -> None:
        begun_s, t_s = time.monotonic(), 0.0
        while True:
            time.sleep(0.02)
            while t_s < time.monotonic() - begun_s:  # a busy machine catches up
                t_s += 0.02
                with contextlib.suppress(BlockingIOError):  # nobody reads
                    os.write(master, says(t_s))

    threading.Thread(target=speak, daemon=True).start()
    return os.ttyname(slave)


class Shell:
    """bash at a terminal whose keyboard is ours; ``text`` is all that it has shown."""

    def __init__(self, environment: dict[str, str]) -> None:
        self._pid, self._master = pty.fork()
        if self._pid == 0:
            os.chdir(BENCH)
            os.execvpe("bash", ["bash", "--norc", "--noprofile", "-i"], environment)
        self.text = ""
        self._seen = 0

    def read_until(self, words: str) -> None:
        """Read until the terminal has shown these words; ends the program when it does not within a minute."""
        deadline_s = time.monotonic() + 60.0
        while words not in self.text[self._seen :]:
            ready, _, _ = select.select([self._master], [], [], max(deadline_s - time.monotonic(), 0.0))
            if not ready:
                raise SystemExit(f"never said: {words!r}\n{self.text}")
            self.text += os.read(self._master, 65536).decode(errors="replace")
        self._seen = self.text.index(words, self._seen) + len(words)

    def enter(self, words: str, then: str) -> None:
        """Type a command and read until it has shown the words ``then``."""
        os.write(self._master, f"{words}\n".encode())
        self.read_until(f"{words}\r\n")  # its echo
        self.read_until(then)

    def close(self) -> None:
        """End what runs in the background, and the shell."""
        os.write(self._master, b"kill %1; wait; exit\n")
        with contextlib.suppress(OSError):
            while os.read(self._master, 65536):
                continue
        os.kill(self._pid, signal.SIGHUP)


def wait_for(condition: Callable[[], bool]) -> None:
    """Until the condition holds, a minute at most."""
    deadline_s = time.monotonic() + 60.0
    while not condition():
        if time.monotonic() > deadline_s:
            raise SystemExit("it does not come up")
        time.sleep(0.1)


def shown(text: str) -> Iterator[str]:
    """The lines as a person sees them: without the terminal's own signs and without what bash says of its jobs."""
    text = re.sub(r"\x1b\[\?\d+[hl]|\x1b\][^\x07]*\x07", "", text).replace("\r\n", "\n").replace("\r", "")
    for line in text.split("\n"):
        if not re.match(r"\[\d+\][ +-]", line) and not re.fullmatch(r"\[\d+\] \d+", line):
            yield line


def save(text: str) -> None:
    """As SVG, with the fonts of whoever looks at it: nothing is fetched."""
    lines = [line for line in shown(text) if line.strip() != PROMPT.strip()]
    with open(os.devnull, "w") as nowhere:
        console = Console(record=True, width=COLUMNS, file=nowhere, force_terminal=True, color_system="truecolor")
        console.print(Text.from_ansi("\n".join(lines)), soft_wrap=False)
    template = inspect.signature(Console.export_svg).parameters["code_format"].default
    template = re.sub(r"@font-face \{\{.*?\}\}\n", "", template, flags=re.DOTALL)
    PICTURE.parent.mkdir(exist_ok=True)
    PICTURE.write_text(console.export_svg(title="spotter setup jetson0", code_format=template, unique_id="setup"))
    sys.stdout.write(f"{PICTURE}: {len(lines)} lines\n")


if __name__ == "__main__":
    main()
