"""What every command says when something is not as it should be: writes docs/situations.md, or compares it.

    python docs/situations.py            # writes the page; about two minutes
    python docs/situations.py --check    # runs the same commands and names what has changed

Every cell is what the command itself printed last, with its exit code: without a router, with a router at which nobody
publishes, with a key or name that does not exist, with a file that is none, and after Ctrl-C in the middle of its work.
"""

from __future__ import annotations

import argparse
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import zenoh
from typer.main import get_command

from common import topics
from common.bus.runtime import Service
from common.bus.session import build
from common.codec import encode
from common.config import ServiceConfig, ZenohConfig
from common.messages import RadarTracks
from common.recording.file import RecordingFile
from spotter_tools.cli.__main__ import app
from spotter_tools.ports import free_port

PAGE = Path(__file__).parent / "situations.md"
REPOSITORY = Path(__file__).resolve().parent.parent
SPOTTER = Path(sys.executable).with_name("spotter")
SITUATIONS = {
    "no_router": "No router",
    "nobody": "A router, and nobody publishes",
    "wrong_name": "A wrong key, name or option",
    "wrong_file": "A wrong file",
    "ctrl_c": "Ctrl-C",
}
CTRL_C = "ctrl_c"
QUIET = "ends without an error message"
SHOWN = {
    " --connect {void}": "",
    " --connect {quiet}": "",
    " --connect {lively}": "",
    " --listen {own}": "",
    " --port {port}": "",
    " --port 0": "",
    "{folder}/": "",
    "{text}": "text.mcap",
    "{site}": "site.toml",
    "{recording}": "drive.mcap",
}
ELSEWHERE = {  # commands that are not run here, and where they are tested
    "setup": "asks a person: tests/tools/cli",
    "gate": "a group of its own: tests/gate",
    "acknowledge": "belongs to the gate: tests/gate",
    "prove": "takes minutes: tests/tools",
    "rerun": "opens a viewer, or names its extra: tests/tools/cli/test_rerun.py",
}
BUDGET_S = 60.0
STARTED_S = 6.0  # after this long every command is in the middle of its work
CASES: dict[str, dict[str, str]] = tomllib.loads((Path(__file__).parent / "situations.toml").read_text())


@dataclass(frozen=True)
class Output:
    """How a command ended: its last line on either stream, the exit code, and everything that it said."""

    last: str
    code: int
    everything: str

    @property
    def cell(self) -> str:
        """For the table."""
        words = self.last.replace("|", "\\|") or "(nothing)"
        return f"{self.code}: {words}"


class Stage:
    """Where the commands are run: endpoints with a router, without one and with a radar, and some files."""

    def __init__(self, folder: Path, quiet: str, lively: str) -> None:
        self._folder, self._quiet, self._lively = folder, quiet, lively
        (folder / "text.mcap").write_text("no recording, no site file\n")
        (folder / "site.toml").write_text("[tls]\nenabled = false\n[hosts.pi0]\n[hosts.pi0.services.radar]\n")
        with RecordingFile(folder / "drive.mcap", {}) as file:
            for turn in range(50):
                message = radar(turn * 100_000_000)
                file.add("pi0/radar/tracks", RadarTracks, encode(message), message.stamp_ns, message.stamp_ns, turn)

    def run(self, words: str, interrupt: bool) -> Output:
        """Run one command; with ``interrupt`` it gets a Ctrl-C once it is at work."""
        names = {
            "void": f"tcp/127.0.0.1:{free_port()}", "quiet": self._quiet, "lively": self._lively,
            "own": f"tcp/127.0.0.1:{free_port()}", "port": str(free_port()), "folder": str(self._folder),
            "text": str(self._folder / "text.mcap"), "site": str(self._folder / "site.toml"),
            "recording": str(self._folder / "drive.mcap"),
        }  # fmt: skip
        command = [str(SPOTTER), *(word.format(**names) for word in words.split())]
        environment = {name: value for name, value in os.environ.items() if not name.startswith("SPOTTER_")}
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=self._folder, env=environment,
            stdin=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
        if interrupt:
            threading.Event().wait(STARTED_S)
            process.send_signal(signal.SIGINT)
        try:
            said, _ = process.communicate(timeout=BUDGET_S)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            said, _ = process.communicate()
            said += "\nDOES NOT END"
        lines = [self._plain(line, names) for line in said.splitlines() if line.strip()]
        broken = [line for line in lines if line.startswith("BROKEN")]  # doctor goes on to look at the machine
        return Output((broken or lines[-1:] or [""])[0], process.returncode, said)

    def _plain(self, line: str, names: dict[str, str]) -> str:
        """Without what differs from run to run."""
        for name in ("void", "quiet", "lively", "own"):
            line = line.replace(names[name], "tcp/127.0.0.1:7447")
        line = line.replace(f"{self._folder}/", "").replace(str(self._folder), ".").replace(f"{REPOSITORY}/", "")
        line = re.sub(r"spotter-\d{8}T\d{6}Z", "spotter-DATE", line)
        return re.sub(r"\d+(\.\d+)? (s|MB|GB|ms)\b", r"N \2", line.strip())


def radar(stamp_ns: int) -> RadarTracks:
    """An empty radar message."""
    return RadarTracks(stamp_ns=stamp_ns, tracks=[], level="SAFE", settled=True, noise_floor_db=-60.0)


@contextmanager
def stage() -> Iterator[Stage]:
    """Two routers and a radar, in this process."""
    stop = threading.Event()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="situations-")))
        endpoints = [f"tcp/127.0.0.1:{free_port()}" for _ in range(2)]
        for endpoint in endpoints:
            router = ZenohConfig(mode="router", connect=(), listen=(endpoint,), namespace="")
            stack.enter_context(zenoh.open(build(router)))
        bus = ZenohConfig(connect=(endpoints[1],))
        service = stack.enter_context(Service("radar", ServiceConfig(host="pi0", zenoh=bus)))
        publish = service.publisher(topics.RADAR_TRACKS)

        def speak() -> None:
            while not stop.wait(0.1):
                publish(radar(time.time_ns()))

        thread = threading.Thread(target=speak)
        thread.start()
        yield Stage(folder, *endpoints)
        stop.set()
        thread.join()


def all_outputs(only: str = "", workers: int = 3) -> dict[tuple[str, str], Output]:
    """By command and situation."""
    cases = [(c, s, words) for c, row in CASES.items() for s, words in row.items() if only in c]
    with stage() as one, ThreadPoolExecutor(workers) as pool:
        outputs = list(pool.map(lambda case: one.run(case[2], case[1] == CTRL_C), cases))
    return {(command, situation): said for (command, situation, _), said in zip(cases, outputs, strict=True)}


def problems(outputs: dict[tuple[str, str], Output]) -> list[str]:
    """What no command may do in any situation: a traceback, success where there was none, silence, no end."""
    found = []
    for (command, situation), said in outputs.items():
        where = f"spotter {command}, {situation}"
        for wrong in ("Traceback", "DOES NOT END", "Error:"):
            if wrong in said.everything:
                found.append(f"{where}: {wrong}\n{said.everything[-2000:]}")
        if situation == CTRL_C and said.code not in (0, 130):
            found.append(f"{where}: exit code {said.code}\n{said.everything[-2000:]}")
        if situation in ("no_router", "wrong_name", "wrong_file") and (said.code not in (1, 2) or not said.last):
            found.append(f"{where}: exit code {said.code}: {said.last or 'not a word'}")
    return found


def missing_commands() -> list[str]:
    """Commands of which no case is in situations.toml."""
    commands = set(get_command(app).commands)  # type: ignore[attr-defined]
    missing = commands - {name.split()[0] for name in CASES} - set(ELSEWHERE)
    return [f"spotter {name}: not in docs/situations.toml" for name in sorted(missing)]


def page(outputs: dict[tuple[str, str], Output]) -> str:
    """The whole of docs/situations.md."""
    lines = [
        "# What a command says when something is not there",
        "",
        "Made by `python docs/situations.py` from what the commands themselves print: exit code and last line, in",
        "each situation that a command can get into. Exit code 1: it could not be done; 2: a wrong option, name or",
        "file. After Ctrl-C it is 0 or 130. `make docs-check` runs all of it again and compares.",
    ]
    for situation, title in SITUATIONS.items():
        lines += [
            "",
            f"## {title}",
            "",
            "| command | exit code and last line |",
            "|---|---|",
        ]
        for (command, at), said in outputs.items():
            if at == situation:
                lines.append(f"| `spotter {shown(CASES[command][at])}` | {QUIET if at == CTRL_C else said.cell} |")
    return "\n".join(lines) + "\n"


def shown(words: str) -> str:
    """A case as a person would type it."""
    for name, plain in SHOWN.items():
        words = words.replace(name, plain)
    return words.strip()


def main() -> None:
    """The command above."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--only", default="", help="the commands whose name contains this; prints them")
    options = parser.parse_args()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # in a background job it would be ignored, here and below
    outputs = all_outputs(options.only)
    wrong = problems(outputs) + (missing_commands() if options.check else [])
    if options.only:
        for (command, situation), said in outputs.items():
            sys.stdout.write(f"{command}, {situation}: {said.cell}\n")
    elif options.check:
        before, now = PAGE.read_text().splitlines(), page(outputs).splitlines()
        wrong += [f"changed: {line}" for line in now if line not in before]
    elif not wrong:
        PAGE.write_text(page(outputs))
    sys.exit("\n".join(wrong) or 0)


if __name__ == "__main__":
    main()
