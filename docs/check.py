"""Runs every command of the pages for people from a fresh tree and compares what it says.

    make docs-check                          # a fresh clone and its own environment; ten minutes and more
    python docs/check.py --here [--only ls]  # the commands alone, with this environment, in a clone; a few minutes

The pages: README.md, CONTRIBUTING.md and all below docs/, services/ and compose/. How each command is run, and what it
has to say, is in docs/check.toml. A command that is not there is an error, and so is one that no page has.
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
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spotter_tools.ports import free_port

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = "docs", "services", "compose"
GENERATED = "situations.md", "troubleshooting.md"
PROGRAMS = r"spotter|spotter-[a-z-]+|make|python|uv|pip|sed|apt|pkill|pytest"
OF_THE_MACHINE = ("sudo ", "apt ", "export ", "git clone ")  # they change the machine, or fetch this very tree
BY_THEMSELVES = ("pytest ", "python -m benchmarks", "python tests/")  # minutes each
BUDGET_S, STOP_AFTER_S, DEMO_UP_S = 300.0, 8.0, 120.0


def documents() -> list[Path]:
    """The pages for people; what is made from the commands themselves is left out."""
    below = [page for folder in FOLDERS for page in sorted((ROOT / folder).rglob("*.md"))]
    return [page for page in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *below) if page.name not in GENERATED]


def commands_of(text: str) -> Iterator[str]:
    """Commands in shell blocks, a line each, and in code spans."""
    for block in re.findall(r"```sh\n(.*?)```", text, re.DOTALL):
        for line in block.splitlines():
            if command := line.split(" #")[0].strip():
                yield command
    spans = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    yield from re.findall(rf"`((?:{PROGRAMS}) [^`]+|spotter-[A-Za-z]+)`", spans)


@dataclass(frozen=True)
class Place:
    """Where the commands are run, and what stands for the placeholders in check.toml."""

    tree: Path
    environment: dict[str, str]
    names: dict[str, str]

    def run(self, command: str, how: dict[str, Any]) -> str:
        """What is wrong with it; empty if nothing is."""
        names = {**self.names, "free": f"tcp/127.0.0.1:{free_port()}"}
        typed = re.sub(r"\{(\w+)\}", lambda name: names.get(name[1], name[0]), how.get("run", command))
        process = subprocess.Popen(
            ["bash", "-c", f"exec {typed}" if how.get("stop") else typed],
            cwd=self.tree, env=self.environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, text=True, start_new_session=True,
        )  # fmt: skip
        if how.get("stop"):
            threading.Event().wait(how.get("after_s", STOP_AFTER_S))
            process.send_signal(signal.SIGINT)
        try:
            said, _ = process.communicate(timeout=BUDGET_S)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            return f"{typed}: does not end"
        allowed = (0, how.get("code", 0), *((130,) if how.get("stop") else ()))
        if process.returncode not in allowed:
            return f"{typed}: exit code {process.returncode}\n{said[-1500:]}"
        if "Traceback" in said or not re.search(how["says"], said):
            return f"{typed}: expected {how['says']!r} in\n{said[-1500:]}"
        return ""


@contextmanager
def place(fresh: bool) -> Iterator[Place]:
    """A clone of what is committed, with an environment of its own if ``fresh``; the demo runs meanwhile."""
    with tempfile.TemporaryDirectory(prefix="docs-check-") as folder:
        tree, connect = Path(folder) / "spotter", f"tcp/127.0.0.1:{free_port()}"
        subprocess.run(["git", "clone", "--quiet", "--local", str(ROOT), str(tree)], check=True)
        if fresh:
            subprocess.run(["make", "setup"], cwd=tree, check=True, stdout=subprocess.DEVNULL)
        programs = tree / ".venv" / "bin" if fresh else Path(sys.executable).parent
        environment = {name: value for name, value in os.environ.items() if not name.startswith("SPOTTER_")}
        environment |= {"PATH": f"{programs}:{environment['PATH']}", "SPOTTER_CONNECT": connect}
        if not fresh:
            environment["PYTHONPATH"] = str(tree)
        names = {"connect": connect, "tmp": folder, "python": sys.executable}
        with demo(tree, environment, connect):
            one = Place(tree, environment, names)
            if wrong := one.run("spotter record first --seconds 5", {"says": "messages"}):
                sys.exit(f"docs-check: the demo cannot be recorded: {wrong}")
            (recording,) = (tree / "first").glob("*.mcap")
            yield Place(tree, environment, {**names, "drive": str(recording)})


@contextmanager
def demo(tree: Path, environment: dict[str, str], connect: str) -> Iterator[None]:
    """The demo, from when it says that it is up."""
    command = ["spotter", "demo", "--listen", connect, "--port", str(free_port())]
    process = subprocess.Popen(command, cwd=tree, env=environment, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    give_up = threading.Timer(DEMO_UP_S, process.kill)
    give_up.start()
    lines = []
    while "Spotter is up" not in (line := process.stderr.readline()):
        lines.append(line)
        if not line:
            sys.exit(f"docs-check: the demo does not come up:\n{''.join(lines[-20:])}")
    give_up.cancel()
    threading.Thread(target=process.stderr.read, daemon=True).start()
    try:
        yield
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(30)


def missing_from_plan(plan: dict[str, dict[str, Any]]) -> list[str]:
    """Where the documents and check.toml differ."""
    found = {command for page in documents() for command in commands_of(page.read_text())}
    left_out = (*OF_THE_MACHINE, *BY_THEMSELVES)
    written = {command for command in found if command in plan or not command.startswith(left_out)}
    return [f"not in docs/check.toml: {command}" for command in sorted(written - set(plan))] + [
        f"in docs/check.toml, but in no document: {command}" for command in sorted(set(plan) - written)
    ]


def read_plan() -> dict[str, dict[str, Any]]:
    """docs/check.toml: command -> how it is run."""
    return tomllib.loads((ROOT / "docs" / "check.toml").read_text())


def main() -> None:
    """The command above."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--here", action="store_true", help="with this environment instead of a fresh one")
    parser.add_argument("--only", default="", help="the commands that contain this")
    options = parser.parse_args()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # in a background job it would be ignored, here and below
    plan, wrong = read_plan(), []
    if not options.only:
        wrong = missing_from_plan(plan)
    with place(fresh=not options.here) as one:
        for command, how in plan.items():
            if options.only not in command:
                continue
            if "skip" in how:
                sys.stdout.write(f"skip  {command}: {how['skip']}\n")
                continue
            problem = one.run(command, how)
            sys.stdout.write(f"{'WRONG' if problem else 'ok   '} {command}\n")
            sys.stdout.flush()
            wrong += [problem] if problem else []
    sys.exit("\n\n".join(wrong) or 0)


if __name__ == "__main__":
    main()
