"""The session of docs/ros2.md as it is written there: their clouds become tracks, our tracks are heard."""

from __future__ import annotations

import importlib.util
import re
import shlex
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[3]
PAGE = REPOSITORY / "docs" / "ros2.md"

pytestmark = [
    pytest.mark.system,
    pytest.mark.slow,
    pytest.mark.timeout(900),  # kernels that have to be compiled, on a busy machine
    pytest.mark.skipif(
        importlib.util.find_spec("zenoh_ros2_sdk") is None, reason="zenoh-ros2-sdk (extra dev) is not installed"
    ),
]


@pytest.fixture
def start() -> Iterator[Callable[[list[str]], subprocess.Popen[str]]]:
    started: list[subprocess.Popen[str]] = []

    def run(words: list[str]) -> subprocess.Popen[str]:
        program = sys.executable if words[0] == "python" else str(Path(sys.executable).with_name(words[0]))
        started.append(
            subprocess.Popen([program, *words[1:]], cwd=REPOSITORY, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
                             text=True)
        )  # fmt: skip
        return started[-1]

    yield run
    for process in reversed(started):
        process.terminate()
    for process in started:
        try:
            process.communicate(timeout=10)
        except subprocess.TimeoutExpired:  # it compiles its kernels, which no signal ends
            process.kill()
            process.communicate()


def commands_of_the_session() -> list[list[str]]:
    session = PAGE.read_text().partition("## A session")[2]
    block = re.search(r"```sh\n(.*?)```", session, re.DOTALL)
    assert block is not None
    return [shlex.split(line) for line in block[1].splitlines()]


def at(words: list[str], port: int) -> list[str]:
    """The same command at another port."""
    where = f"127.0.0.1:{port}"
    if words[:2] == ["spotter", "router"]:
        return [*words[:-1], f"tcp/{where}"]
    if words[0] == "python":
        return [*words, "--router", where, *(["--columns", "600"] if "points" in words else ["--seconds", "200"])]
    if words[0] == "spotter":
        return [*words, "--connect", f"tcp/{where}"]
    return [*words, "--set", f'zenoh.connect=["tcp/{where}"]', "--set", "visibility.budget_ms=1000"]


def answers(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def test_the_session_of_the_page(free_ports: Callable[[], int], start, until) -> None:
    compiled = [sys.executable, "-m", "services.infra_lidar.warm_up"]  # as `make setup` does: nothing where it is done
    subprocess.run(compiled, cwd=REPOSITORY, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    port, commands = free_ports(), commands_of_the_session()
    assert [words[0] for words in commands] == ["spotter", "python", "spotter-infra-lidar", "spotter", "python"]
    router = start(at(commands[0], port))
    until(lambda: answers(port), "the router listens")
    *others, listener = [router, *(start(at(words, port)) for words in commands[1:])]
    output, _ = listener.communicate(timeout=230)
    assert listener.returncode == 0, "our tracks were heard by a program of another hand"
    lines = [line for line in output.splitlines() if line.startswith("/spotter_simulated/infra0/infra_lidar/objects: ")]
    assert len(lines) == 5
    assert any("TrackedObject(" in line for line in lines), "their clouds became tracks"
    assert all(process.poll() is None for process in others)
