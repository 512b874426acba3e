"""`make setup` that was interrupted at any moment is made again by the next one."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

pytestmark = [pytest.mark.system, pytest.mark.slow, pytest.mark.timeout(280)]
REPOSITORY = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def clone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tracked files of this tree, without a ``.venv``."""
    folder = tmp_path_factory.mktemp("clone")
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=REPOSITORY, capture_output=True, text=True, check=True)
    for name in filter(None, listed.stdout.split("\0")):
        if (REPOSITORY / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(REPOSITORY / name, folder / name)
    return folder


def setup(clone: Path, **variables: str) -> subprocess.Popen[bytes]:
    """The small extra ``keys`` only: what is tested is the order of the steps."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | variables
    command = ["make", "setup", "EXTRAS=keys"]
    return subprocess.Popen(command, cwd=clone, env=environment, start_new_session=True)


def interrupt_when(clone: Path, moment: Callable[[], bool]) -> None:
    """Ctrl-C at that moment: SIGINT to all of its processes."""
    process, pause, deadline_s = setup(clone), threading.Event(), time.monotonic() + 120
    while not moment():
        assert process.poll() is None, "over before the moment came"
        assert time.monotonic() < deadline_s
        pause.wait(0.005)
    os.killpg(process.pid, signal.SIGINT)
    assert process.wait(30) != 0


def packages(clone: Path) -> Path:
    return next((clone / ".venv").glob("lib/python3*/site-packages"), clone / "none")


def test_a_setup_interrupted_at_several_moments_is_completed_by_the_next(clone: Path) -> None:
    interrupt_when(clone, lambda: (clone / ".venv" / "bin" / "python").exists())  # there is no pip yet
    interrupt_when(clone, lambda: (packages(clone) / "pip").exists())
    interrupt_when(clone, lambda: (clone / ".venv" / "bin" / "uv").exists())
    interrupt_when(clone, lambda: (clone / ".venv" / ".installing").exists())
    assert not (clone / ".venv" / ".ready").exists()
    assert setup(clone).wait(240) == 0
    completed = subprocess.run([clone / ".venv/bin/spotter", "--help"], capture_output=True, text=True, check=True)
    assert "Perception over Zenoh" in completed.stdout


def test_ctrl_c_ends_it_also_between_two_steps(clone: Path, tmp_path: Path) -> None:
    """Bash goes on after a SIGINT when the command that it waited for ended well: here ``touch`` does."""
    (clone / ".venv" / ".ready").unlink()
    touch = tmp_path / "touch"
    touch.write_text(f"#!/bin/sh\ntrap '' INT\nkill -INT 0\nexec {shutil.which('touch')} \"$@\"\n")
    touch.chmod(0o755)
    assert setup(clone, PATH=f"{tmp_path}:{os.environ['PATH']}").wait(240) != 0
    assert not (clone / ".venv" / ".ready").exists()
    assert (clone / ".venv" / ".installing").exists()


def test_a_uv_that_cannot_run_is_installed_again(clone: Path) -> None:
    (clone / ".venv" / "bin" / "uv").chmod(0o644)
    (clone / ".venv" / ".ready").unlink(missing_ok=True)
    assert setup(clone).wait(240) == 0


def refused(folder: Path, **environment: str) -> str:
    """What ``make setup`` says when it cannot."""
    ended = subprocess.run(
        ["make", "setup", "EXTRAS=keys"], cwd=folder, env={**os.environ, **environment}, capture_output=True, text=True,
        timeout=200, check=False,
    )  # fmt: skip
    assert ended.returncode != 0
    return ended.stderr


def test_without_a_network_the_first_setup_says_so(clone: Path, tmp_path: Path) -> None:
    fresh = tmp_path / "clone"
    shutil.copytree(clone, fresh, ignore=shutil.ignore_patterns(".venv"))
    nowhere = {"PIP_CONFIG_FILE": "/dev/null", "PIP_INDEX_URL": "http://127.0.0.1:9/simple", "PIP_RETRIES": "0"}
    stderr = refused(fresh, **nowhere)
    assert "the package index cannot be reached; the first setup needs a network" in stderr
    assert "WARNING" not in stderr  # pip's own words are in the log


@pytest.mark.skipif(shutil.which("unshare") is None or os.geteuid() != 0, reason="needs root and unshare")
def test_a_read_only_clone_says_so(clone: Path) -> None:
    command = f"mount --bind {clone} {clone} && mount -o remount,bind,ro {clone} && make -C {clone} setup EXTRAS=keys"
    (clone / ".venv" / ".ready").unlink(missing_ok=True)
    ended = subprocess.run(
        ["unshare", "--mount", "bash", "-c", command], capture_output=True, text=True, timeout=60, check=False
    )
    if "permission denied" in ended.stderr or "unshare failed" in ended.stderr:
        pytest.skip("no mount namespace here")
    assert ended.returncode != 0
    assert "cannot be written: the environment (.venv) is made in the clone" in ended.stderr
