"""Hosts as network namespaces of this machine, on one bridge, to test a whole site with real links.

Needs root. Everything made here is removed by ``close``; nothing is made in the machine's own namespace.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import uuid
from pathlib import Path
from types import TracebackType

SUBNET = "10.77.0"
STOP_BUDGET_S = 15.0
_DROP = ("INPUT", "OUTPUT")


def missing() -> str:
    """Why namespaces cannot be made here; empty when they can."""
    if os.geteuid() != 0:
        return "network namespaces need root"
    for program in ("ip", "iptables", "tc"):
        if shutil.which(program) is None:
            return f"{program} is not installed"
    probe = f"spotter-{uuid.uuid4().hex[:6]}"
    if subprocess.run(["ip", "netns", "add", probe], capture_output=True, check=False).returncode:
        return "this container may not make network namespaces"
    subprocess.run(["ip", "netns", "del", probe], check=False)
    return ""


class Lab:
    """``Lab(("pi0", "jetson0"), folder)``: one namespace per host; ``address(host)`` is its IP address."""

    def __init__(self, hosts: tuple[str, ...], folder: Path) -> None:
        self.hosts, self.folder = hosts, folder
        self._mark = uuid.uuid4().hex[:4]
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._slow: dict[str, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> Lab:
        self._ip("netns", "add", self.space("net"))
        self._in("net", "ip", "link", "add", "bridge0", "type", "bridge")
        self._in("net", "ip", "link", "set", "bridge0", "up")
        for host in self.hosts:
            self._join(host)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.stop(*self._processes)
        for host in (*self.hosts, "net"):
            for pid in self.pids(host):  # processes that outlived the commands which started them
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            subprocess.run(["ip", "netns", "del", self.space(host)], capture_output=True, check=False)

    def space(self, host: str) -> str:
        """The name of the network namespace that stands for ``host``."""
        return f"spotter-{self._mark}-{host}"

    def address(self, host: str) -> str:
        """The IPv4 address of ``host`` on the lab's one network."""
        return f"{SUBNET}.{self.hosts.index(host) + 1}"

    def start(self, name: str, host: str, command: list[str], **environment: str) -> None:
        """Run a command on a host; its output goes to ``<folder>/<name>.log``."""
        with (self.folder / f"{name}.log").open("ab") as log:
            self._processes[name] = subprocess.Popen(
                ["ip", "netns", "exec", self.space(host), *command],
                stdout=log,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                start_new_session=True,
                env={**os.environ, **environment},
            )

    def run(self, host: str, command: list[str], **environment: str) -> subprocess.CompletedProcess[str]:
        """Run a command on a host to its end."""
        words = ["ip", "netns", "exec", self.space(host), *command]
        return subprocess.run(words, capture_output=True, text=True, check=False, env={**os.environ, **environment})

    def stop(self, *names: str) -> None:
        """Stop these together by SIGTERM. Not by SIGINT: a process started in the background of a script ignores it."""
        stopping = [self._processes.pop(name) for name in names]
        for process in stopping:
            process.send_signal(signal.SIGTERM)
        for process in stopping:
            try:
                process.wait(STOP_BUDGET_S)
            except subprocess.TimeoutExpired:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()

    def pids(self, host: str, word: str = "") -> list[int]:
        """Processes of a host; with ``word``, only those that have it as an argument on their command line."""
        words = ["ip", "netns", "pids", self.space(host)]
        listed = subprocess.run(words, capture_output=True, text=True, check=False)
        found = []
        for pid in map(int, listed.stdout.split()):
            with contextlib.suppress(OSError):
                if not word or word.encode() in Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0"):
                    found.append(pid)
        return found

    def cut(self, host: str) -> None:
        """Drop every packet silently, in both directions: for the other hosts this is like a pulled cable."""
        for chain in _DROP:
            self._in(host, "iptables", "-I", chain, *_side(chain), "-j", "DROP")

    def heal(self, host: str) -> None:
        """Undo cut, loss, throttle and delay."""
        for chain in _DROP:
            self._in(host, "iptables", "-F", chain)
        self._try(host, "tc", "qdisc", "del", "dev", "eth0", "root")
        self._try("net", "tc", "qdisc", "del", "dev", self._port(host), "root")
        slow = self._slow.pop(host, None)
        if slow is not None:
            self._in("net", "ip", "link", "set", self._port(host), "master", "bridge0")
            slow.kill()
            slow.communicate()
            for device in _devices(host):
                self._in("net", "ip", "link", "del", device)

    def lose(self, host: str, share: float) -> None:
        """Drop this share of the packets in each direction."""
        rule = ["-m", "statistic", "--mode", "random", "--probability", str(share), "-j", "DROP"]
        for chain in _DROP:
            self._in(host, "iptables", "-I", chain, *_side(chain), *rule)

    def throttle(self, host: str, mbit_s: float) -> None:
        """Limit both directions of a host's link (token bucket, 50 ms of queue)."""
        limits = ["tbf", "rate", f"{mbit_s}mbit", "burst", "32kb", "latency", "50ms"]
        self._in(host, "tc", "qdisc", "add", "dev", "eth0", "root", *limits)
        self._in("net", "tc", "qdisc", "add", "dev", self._port(host), "root", *limits)

    def delay(self, host: str, seconds: float) -> None:
        """Let each frame take this much longer in each direction: a relay between this host's cable and the bridge."""
        near, far, bridge = _devices(host)
        self._in("net", "ip", "link", "add", bridge, "type", "bridge")
        for tap, where in ((near, bridge), (far, "bridge0")):
            self._in("net", "ip", "tuntap", "add", "dev", tap, "mode", "tap")
            self._in("net", "ip", "link", "set", tap, "master", where, "up")
        self._in("net", "ip", "link", "set", bridge, "up")
        words = ["ip", "netns", "exec", self.space("net"), sys.executable, "-m", "spotter_tools.drill.delayed_link"]
        slow = self._slow[host] = subprocess.Popen([*words, near, far, str(seconds)], stdout=subprocess.PIPE)
        assert slow.stdout is not None
        if not slow.stdout.readline():
            raise OSError(f"the relay for {host} ended with code {slow.wait()}")
        self._in("net", "ip", "link", "set", self._port(host), "master", bridge)

    def _join(self, host: str) -> None:
        space, port = self.space(host), self._port(host)
        self._ip("netns", "add", space)
        self._in("net", "ip", "link", "add", port, "type", "veth", "peer", "name", "eth0", "netns", space)
        self._in("net", "ip", "link", "set", port, "master", "bridge0", "up")
        self._in(host, "ip", "addr", "add", f"{self.address(host)}/24", "dev", "eth0")
        self._in(host, "ip", "link", "set", "eth0", "up")
        self._in(host, "ip", "link", "set", "lo", "up")

    def _port(self, host: str) -> str:
        return f"to-{host}"[:15]

    def _ip(self, *words: str) -> None:
        subprocess.run(["ip", *words], check=True, capture_output=True)

    def _in(self, host: str, *words: str) -> None:
        subprocess.run(["ip", "netns", "exec", self.space(host), *words], check=True, capture_output=True)

    def _try(self, host: str, *words: str) -> None:
        subprocess.run(["ip", "netns", "exec", self.space(host), *words], check=False, capture_output=True)


def _devices(host: str) -> tuple[str, str, str]:
    """Names of the two ends of a slow cable and of the bridge at its near end (15 characters at most)."""
    return f"near-{host}"[:15], f"far-{host}"[:15], f"slow-{host}"[:15]


def _side(chain: str) -> tuple[str, str]:
    return ("-i" if chain == "INPUT" else "-o", "eth0")
