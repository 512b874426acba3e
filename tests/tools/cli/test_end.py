"""How the `spotter` command ends: with the right exit code, at once, whatever Zenoh's threads are doing."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

SPOTTER = str(Path(sys.executable).with_name("spotter"))
LEFT_OPEN = """
import json, zenoh
from spotter_tools.cli import __main__ as cli

def app(standalone_mode):
    alone = {"scouting": {"multicast": {"enabled": False}}, "listen": {"endpoints": []}}
    config = zenoh.Config.from_json5(json.dumps(alone))
    cli.session = zenoh.open(config)
    cli.subscriber = cli.session.declare_subscriber("anything", lambda sample: None)
    cli.session.put("anything", b"")
    print("told")
    %s

cli.app = app
cli.main()
"""


@pytest.mark.parametrize(
    ("ending", "code", "reason"),
    [
        ("return", 0, ""),
        ("raise SystemExit(3)", 3, ""),
        ("raise SystemExit", 0, ""),
        ("raise SystemExit('no such host')", 1, "no such host"),
        ("raise KeyboardInterrupt", 130, ""),
        ("raise RuntimeError('broken')", 1, "RuntimeError: broken"),
    ],
)
def test_a_session_left_open_keeps_no_command_alive(ending: str, code: int, reason: str) -> None:
    """Nor is it aborted while Python clears up."""
    ended = subprocess.run(
        [sys.executable, "-c", LEFT_OPEN % ending], capture_output=True, text=True, timeout=30, check=False
    )
    assert ended.returncode == code, ended.stderr
    assert ended.stdout == "told\n"
    assert reason in ended.stderr
    assert reason or not ended.stderr


def test_a_reader_who_has_seen_enough_is_no_failure() -> None:
    with subprocess.Popen([SPOTTER, "--help"], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.close()
        assert process.stderr is not None
        assert b"Traceback" not in process.stderr.read()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
def test_what_could_not_be_written_is_a_failure() -> None:
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run([SPOTTER, "--help"], stdout=full, stderr=subprocess.PIPE, timeout=30, check=False)
    assert ended.returncode != 0


HZ = ["-m", "spotter_tools.cli.entry", "hz", "*/*/*", "--connect", "tcp/127.0.0.1:1"]
LIDAR = ["-c", "from services.entry import lidar; lidar()", "--show-config"]


@pytest.mark.parametrize(
    ("words", "loaded", "code"), [(HZ, "msgspec", 130), (HZ, "zenoh", 130), (HZ, "numpy", 130), (LIDAR, "numpy", 0)]
)
def test_an_interrupt_while_it_is_still_being_loaded_is_quiet(words: list[str], loaded: str, code: int) -> None:
    """As soon as a library of ours is mapped, its process is in the middle of the imports."""
    command = [sys.executable, *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        maps = Path(f"/proc/{process.pid}/maps")
        while loaded not in maps.read_text():
            assert process.poll() is None
        process.send_signal(signal.SIGINT)
        said, error_text = process.communicate(timeout=30)
    assert process.returncode == code
    assert (said, error_text) == ("", "")
