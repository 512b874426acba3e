"""The supervisor with real processes: restart, back-off, prefixed logs, clean stop, refusal."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from common.config import ConfigError
from common.host import supervisor as module
from common.host.adoption import INBOX_VARIABLE, Successor, inbox_of, write_successor
from common.host.process_plan import Plan, children, parse_settings, services_of
from common.host.supervisor import Child, Supervisor
from common.topics import SERVICES

pytestmark = pytest.mark.system

SLEEPER = """
import signal, sys
signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
print('up', flush=True)
while True:
    signal.pause()
"""


def python(name: str, code: str) -> Child:
    return Child(name, [sys.executable, "-c", code])


async def until(condition: Callable[[], object]) -> None:
    async with asyncio.timeout(60):
        while not condition():
            await asyncio.sleep(0.005)


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_a_killed_child_comes_back_and_the_others_are_left_alone() -> None:
    lines: list[str] = []
    killed, spared = python("killed", SLEEPER), python("spared", SLEEPER)

    async def scenario() -> int:
        supervisor = Supervisor([killed, spared], write=lines.append)
        running = asyncio.create_task(supervisor.run())
        await until(lambda: sum("up" in line for line in lines) == 2)
        spared_pid, first_pid = spared.pid, killed.pid
        assert first_pid is not None
        os.kill(first_pid, signal.SIGKILL)
        await until(lambda: sum("killed | up" in line for line in lines) == 2)
        assert killed.pid != first_pid
        assert spared.pid == spared_pid
        pids = [killed.pid, spared.pid]
        supervisor.stop()
        code = await running
        assert not any(alive(pid) for pid in pids if pid)
        return code

    assert asyncio.run(scenario()) == 0
    assert any("killed by SIGKILL; starting it again in 0.2 s" in line for line in lines)
    assert all(line.startswith(("killed |", "spared |")) for line in lines)


def test_a_wrong_config_stops_everything_with_its_exit_code() -> None:
    lines: list[str] = []
    broken = python("broken", "import sys; print('spotter: radar.toml: bad'); sys.exit(2)")
    supervisor = Supervisor([python("other", SLEEPER), broken], write=lines.append)
    assert asyncio.run(supervisor.run()) == 2
    assert any("radar.toml: bad" in line for line in lines)


def test_a_command_that_is_not_installed_is_told_and_stops_everything() -> None:
    lines: list[str] = []
    supervisor = Supervisor([python("other", SLEEPER), Child("gone", ["/no/such/spotter-radar"])], write=lines.append)
    assert asyncio.run(supervisor.run()) == 2
    assert any("/no/such/spotter-radar is not installed here" in line for line in lines)


def test_a_child_that_ends_by_itself_is_not_started_again() -> None:
    child = python("short", "print('done')")
    assert asyncio.run(Supervisor([child], write=lambda _: None).run()) == 0
    assert child.starts == 1


STOPPABLE = """
import signal
from common.bus.service_app import run_until_stopped
def run():
    print('up', flush=True)
    while True:
        signal.pause()
run_until_stopped(run)
"""


@pytest.mark.parametrize("signum", [signal.SIGTERM, signal.SIGINT])
def test_a_service_that_somebody_else_ends_comes_back(signum: signal.Signals) -> None:
    """Its exit code is 0, as after work that is done."""
    lines: list[str] = []
    child = python("service", STOPPABLE)

    async def scenario() -> None:
        supervisor = Supervisor([child], write=lines.append)
        running = asyncio.create_task(supervisor.run())
        await until(lambda: "service | up\n" in lines)
        assert child.pid is not None
        os.kill(child.pid, signum)
        await until(lambda: lines.count("service | up\n") == 2)
        supervisor.stop()
        assert await running == 0

    asyncio.run(scenario())
    assert "service | was told to end by somebody else; starting it again in 0.2 s\n" in lines


def test_back_off_grows_and_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    lines: list[str] = []
    monkeypatch.setattr(module, "FIRST_BACKOFF_S", 0.1)
    monkeypatch.setattr(module, "LONGEST_BACKOFF_S", 0.3)
    child = python("failing", "import sys; sys.exit(7)")

    async def scenario() -> None:
        supervisor = Supervisor([child], write=lines.append)
        running = asyncio.create_task(supervisor.run())
        await until(lambda: child.starts >= 5)
        supervisor.stop()
        await running

    asyncio.run(scenario())
    waits = [line.split(" in ")[1].split(" s")[0] for line in lines if "code 7" in line]
    assert waits[:4] == ["0.1", "0.2", "0.3", "0.3"]


def test_a_deaf_child_is_killed_after_the_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "STOP_BUDGET_S", 0.2)
    lines: list[str] = []
    deaf = python(
        "deaf", "import signal; signal.signal(15, signal.SIG_IGN); print('up', flush=True)\nwhile True: signal.pause()"
    )

    async def scenario() -> None:
        supervisor = Supervisor([deaf], write=lines.append)
        running = asyncio.create_task(supervisor.run())
        await until(lambda: lines)
        supervisor.stop()
        await running

    asyncio.run(scenario())
    assert any("did not stop within" in line for line in lines)


ALIVE = """
import itertools, time
from common.bus.watchdog import Watchdog
watchdog = Watchdog('radar')
for count in itertools.count():
    if {ready}:
        watchdog.ready()
    watchdog.alive()
    if not count:
        print('up', flush=True)
    time.sleep(0.05)
"""


def test_a_process_that_falls_silent_is_replaced_and_one_that_never_spoke_is_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "SILENT_LIMIT_S", 2.0)
    lines: list[str] = []
    frozen, stranger = python("frozen", ALIVE.format(ready=True)), python("stranger", ALIVE.format(ready=False))

    async def scenario() -> None:
        supervisor = Supervisor([frozen, stranger], write=lines.append)
        running = asyncio.create_task(supervisor.run())
        await until(lambda: sum("up" in line for line in lines) == 2)
        pids = [pid for pid in (frozen.pid, stranger.pid) if pid is not None]
        for pid in pids:
            os.kill(pid, signal.SIGSTOP)
        await until(lambda: frozen.starts == 2 and lines.count("frozen   | up\n") == 2)
        assert frozen.pid != pids[0]
        assert (stranger.pid, stranger.starts) == (pids[1], 1)
        supervisor.stop()
        assert await running == 0

    asyncio.run(scenario())
    assert any("does not answer: no sign of life for 2 s; it is replaced" in line for line in lines)


def test_children_die_with_a_killed_supervisor(tmp_path: Path) -> None:
    pid_file = tmp_path / "pid"
    code = (
        "import asyncio, sys\n"
        "from common.host.supervisor import Child, Supervisor\n"
        f"child = Child('c', [sys.executable, '-c', {SLEEPER!r}])\n"
        "def note(line):\n"
        f"    open({str(pid_file)!r}, 'w').write(str(child.pid))\n"
        "asyncio.run(Supervisor([child], write=note).run())\n"
    )

    async def scenario() -> None:
        environment = {**os.environ, "TMPDIR": str(tmp_path)}  # a killed one leaves its folder
        process = await asyncio.create_subprocess_exec(sys.executable, "-c", code, env=environment)
        await until(lambda: pid_file.exists() and pid_file.read_text())
        pid = int(pid_file.read_text())
        process.kill()
        await process.wait()
        await until(lambda: not alive(pid))

    asyncio.run(scenario())


class Swapped:
    """A supervised process that tells where its supervisor is, and another one that takes its place."""

    def __init__(self, folder: Path) -> None:
        inbox_file = folder / "told"
        tell = f"import os; open({str(inbox_file)!r}, 'w').write(os.environ['{INBOX_VARIABLE}'])"
        self.child, self.inbox_file = python("radar", SLEEPER.replace("print('up'", f"{tell}; print('up'")), inbox_file
        self.new = subprocess.Popen([sys.executable, "-c", SLEEPER], stdout=subprocess.PIPE)

    async def take_over(self, *, kept: bool) -> None:
        await until(lambda: self.child.pid and self.inbox_file.exists() and self.inbox_file.read_text())
        assert self.new.stdout is not None
        self.new.stdout.readline()
        self.write_successor(kept)
        assert self.child.pid is not None
        os.kill(self.child.pid, signal.SIGTERM)
        await until(lambda: self.child.pid == self.new.pid)

    def write_successor(self, kept: bool) -> None:
        inbox = inbox_of({INBOX_VARIABLE: self.inbox_file.read_text()})
        assert inbox is not None
        words = [sys.executable, "-c", "print('new', flush=True)\n" + SLEEPER]
        write_successor(inbox, "radar", Successor(self.new.pid, words, dict(os.environ), "/", kept))

    def close(self) -> None:
        self.new.kill()
        self.new.communicate()


@pytest.fixture
def swapped(tmp_path: Path) -> Iterator[Swapped]:
    swapped = Swapped(tmp_path)
    yield swapped
    swapped.close()


@pytest.mark.parametrize("kept", [True, False], ids=["kept", "on probation"])
def test_whoever_took_over_is_minded_and_started_again_or_rolled_back(swapped: Swapped, kept: bool) -> None:
    lines: list[str] = []

    async def scenario() -> None:
        supervisor = Supervisor([swapped.child], write=lines.append)
        running = asyncio.create_task(supervisor.run())
        await swapped.take_over(kept=False)
        if kept:
            swapped.write_successor(kept=True)
        swapped.new.kill()
        await until(lambda: swapped.child.starts == 2 and lines[-1] == "radar | up\n")
        supervisor.stop()
        assert await running == 0

    asyncio.run(scenario())
    assert any(f"process {swapped.new.pid} has taken over" in line for line in lines)
    assert any("ended; starting it again" in line for line in lines)
    assert any("new" in line for line in lines) == kept


def test_whoever_took_over_is_stopped_with_the_others_and_the_folder_goes(swapped: Swapped) -> None:
    async def scenario() -> None:
        supervisor = Supervisor([swapped.child], write=lambda _: None)
        running = asyncio.create_task(supervisor.run())
        await swapped.take_over(kept=True)
        supervisor.stop()
        assert await running == 0

    asyncio.run(scenario())
    assert swapped.new.wait(10) == 0
    assert swapped.child.starts == 1
    assert inbox_of({INBOX_VARIABLE: swapped.inbox_file.read_text()}) is None


def test_hosts_know_their_services() -> None:
    assert [row.name for row in services_of("pi0")] == ["radar"]
    with pytest.raises(ConfigError, match="known hosts: infra0, jetson0, pi0"):
        services_of("pi9")


def test_a_plan_becomes_commands(tmp_path: Path) -> None:
    (tmp_path / "radar.toml").write_text("")
    plan = Plan(
        listen=("tcp/127.0.0.1:1",),
        config_dir=tmp_path,
        sources={"radar": "sim:empty"},
        settings=parse_settings(["radar.cfar.threshold_db=14"]),
    )
    started = {child.name: child.command for child in children(list(SERVICES), plan)}
    assert list(started) == ["router", "radar", "lidar", "camera", "fusion", "dashboard", "infra_lidar"]
    assert started["router"][1:] == ["router", "--listen", "tcp/127.0.0.1:1"]
    radar = started["radar"]
    assert radar[0].endswith("spotter-radar")
    assert radar[radar.index("--config") + 1] == str(tmp_path / "radar.toml")
    assert "cfar.threshold_db=14" in radar
    assert radar[-2:] == ["--source", "sim:empty"]
    assert "--config" not in started["lidar"]


@pytest.mark.parametrize("text", ["radar", "radar.x", "sonar.a=1"])
def test_settings_name_a_service(text: str) -> None:
    with pytest.raises(ConfigError, match="--set"):
        parse_settings([text])
