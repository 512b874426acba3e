"""A whole site in network namespaces, and each way to break a link: for deploy.py and tests/system/test_hosts.py.

pi0, jetson0 and infra0 run the real services on simulated sensors, gate0 runs a router alone, and the laptop is a
client of that one. TLS and access rules are on.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from common import topics
from common.clock import monotonic_s
from common.security import authority
from spotter_tools.drill.namespaces import Lab

SERVICES = {
    host: tuple(row.name for row in topics.SERVICES if row.host == host and row.name != "dashboard")
    for host in ("pi0", "jetson0", "infra0", "gate0")
}
HOSTS = (*SERVICES, "laptop1")
# What the vehicle's fusion cannot hear while this host is cut off, or while its router is down.
BEHIND = {"pi0": ("radar",), "jetson0": ("radar", "infra_lidar"), "infra0": ("infra_lidar",)}
FAULTS = ("cut", "delay", "loss", "throttle")
DELAY_S, LOSS, MBIT_S = 0.1, 0.05, 20.0  # delay and loss in each direction
VERDICT_AGE_S = 0.25  # a verdict older than this means STOP to whoever acts on it
SPOTTER = str(Path(sys.executable).with_name("spotter"))
Line = dict[str, Any]
Fits = Callable[[Line], bool]


def make_site(lab: Lab) -> None:
    """site.toml and everybody's certificates, in the lab's folder."""
    keys, lines = lab.folder / "keys", []
    authority.init(keys, "spotter")
    for host, services in SERVICES.items():
        authority.issue(keys, host, "host", (lab.address(host),))
        lines += [f"[hosts.{host}]", f'address = "{lab.address(host)}"']
        lines += [f"[hosts.{host}.services.{one}]" for one in services]
    for laptop in ("laptop1", "revoked1"):
        authority.issue(keys, laptop, "laptop")
    authority.revoke(keys, "revoked1")
    (lab.folder / "site.toml").write_text("\n".join(["accept_simulated = true", *lines]) + "\n")


def up(lab: Lab, host: str, scenario: str = "empty") -> None:
    """Boot a host: its router and its services."""
    lab.start(host, host, [SPOTTER, "up", host, "--sim", scenario, "--site", str(lab.folder / "site.toml")])


def kill_router(lab: Lab, host: str) -> None:
    """SIGKILL; the host's supervisor replaces it."""
    for pid in lab.pids(host, "router"):
        os.kill(pid, signal.SIGKILL)


@contextmanager
def broken(lab: Lab, host: str, fault: str) -> Iterator[None]:
    """One of FAULTS on the link of one host, as long as the block lasts."""
    match fault:
        case "cut":
            lab.cut(host)
        case "delay":
            lab.delay(host, DELAY_S)
        case "loss":
            lab.lose(host, LOSS)
        case "throttle":
            lab.throttle(host, MBIT_S)
    try:
        yield
    finally:
        lab.heal(host)


class TopicTap:
    """A process on a host of the lab that receives verdict and health, each as one line with its monotonic time."""

    def __init__(self, lab: Lab, host: str) -> None:
        words = ["ip", "netns", "exec", lab.space(host), sys.executable, "-m", "benchmarks.lab_tap"]
        self._process = subprocess.Popen([*words, str(lab.folder), host], stdout=subprocess.PIPE)
        self._lines: list[Line] = []
        self._news = threading.Condition()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            with self._news:
                self._lines.append(json.loads(line))
                self._news.notify_all()

    def wait(self, wanted: Fits, since_s: float = 0.0, budget_s: float = 60.0) -> float:
        """The time of the first such line after ``since_s``.

        Raises:
            TimeoutError: it did not come within ``budget_s``.
        """
        deadline_s, looked_at = monotonic_s() + budget_s, 0
        with self._news:
            while True:
                for line in self._lines[looked_at:]:
                    if line["at"] >= since_s and wanted(line):
                        return float(line["at"])
                looked_at = len(self._lines)
                left_s = deadline_s - monotonic_s()
                if left_s <= 0.0:
                    raise TimeoutError(f"not received within {budget_s} s; last: {self._lines[-2:]}")
                self._news.wait(left_s)

    def between(self, start_s: float, end_s: float) -> list[Line]:
        """The lines of an interval."""
        with self._news:
            return [line for line in self._lines if start_s <= line["at"] <= end_s]

    def close(self) -> None:
        """End the process and wait for its last line."""
        self._process.terminate()
        self._process.wait()
        self._reader.join()
        assert self._process.stdout is not None
        self._process.stdout.close()


def is_verdict(line: Line) -> bool:
    """True for any verdict."""
    return bool(line["kind"] == "verdict")


def state(sensor: str, *wanted: str) -> Fits:
    """A health message in which the sensor has one of these states."""
    return lambda line: line["kind"] == "health" and line["states"].get(sensor) in wanted


def all_online(line: Line) -> bool:
    """A health message in which all sensors are online."""
    return all(state(sensor, "online")(line) for sensor in topics.SENSOR_TOPICS)


@dataclass(frozen=True)
class Noticed:
    """What a tap received during a fault; times in seconds, None = it never happened."""

    notice_s: float | None  # from the fault to the first sign of it
    recover_s: float | None  # from its end to everything online again
    verdict_hz: float  # meanwhile
    gap_s: float  # the longest time without a verdict
    causes: tuple[str, ...]  # what health named
    wrong: tuple[str, ...]  # statements that must not occur

    @classmethod
    def by(cls, tap: TopicTap, lost: tuple[str, ...], begun_s: float, ended_s: float, back_s: float) -> Noticed:
        """From a tap on the vehicle: exactly the sensors in ``lost`` have to be reported missing."""
        lines = tap.between(begun_s, ended_s)
        health = [line for line in lines if line["kind"] == "health"]
        bad = [line for line in health if any(line["states"].get(name) != "online" for name in topics.SENSOR_TOPICS)]
        times_s = _verdict_times_s(lines, begun_s, ended_s)
        return cls(
            notice_s=bad[0]["at"] - begun_s if bad else None,
            recover_s=back_s - ended_s if bad else None,
            verdict_hz=(len(times_s) - 2) / (ended_s - begun_s),
            gap_s=max(b - a for a, b in pairwise(times_s)),
            causes=tuple(sorted({line["causes"][name] for line in bad for name in topics.SENSOR_TOPICS} - {""})),
            wrong=tuple(_wrong(lines, lost)),
        )

    @classmethod
    def by_laptop(cls, tap: TopicTap, begun_s: float, ended_s: float, back_s: float) -> Noticed:
        """From a tap that may itself be cut off: it detects the fault by the age of the newest verdict."""
        times_s = _verdict_times_s(tap.between(begun_s, ended_s), begun_s, ended_s)
        silent = next((a for a, b in pairwise(times_s) if b - a > VERDICT_AGE_S), None)
        return cls(
            notice_s=None if silent is None else silent + VERDICT_AGE_S - begun_s,
            recover_s=None if silent is None else back_s - ended_s,
            verdict_hz=(len(times_s) - 2) / (ended_s - begun_s),
            gap_s=max(b - a for a, b in pairwise(times_s)),
            causes=() if silent is None else ("no verdict",),
            wrong=(),
        )


def _verdict_times_s(lines: list[Line], begun_s: float, ended_s: float) -> list[float]:
    """When verdicts came, between the two ends of the interval."""
    return [begun_s, *(line["at"] for line in lines if is_verdict(line)), ended_s]


def _wrong(lines: list[Line], lost: tuple[str, ...]) -> Iterator[str]:
    """What health and verdict may not say with these sensors out of reach and nothing near the vehicle."""
    for line in lines:
        if line["kind"] == "health":
            if _missing(line) - set(lost):
                yield f"{', '.join(sorted(_missing(line) - set(lost)))} not online"
        elif line["level"] != "SAFE" and not lost:
            yield f"verdict {line['level']} by {line['rule']}"
    known_s = next((line["at"] for line in lines if line["kind"] == "health" and _missing(line) & set(lost)), None)
    last = next((line for line in reversed(lines) if is_verdict(line)), None)
    if known_s is not None and last is not None and last["at"] > known_s and set(lost) & set(last["used"]):
        yield f"the last verdict still uses {', '.join(sorted(set(lost) & set(last['used'])))}"


def _missing(line: Line) -> set[str]:
    return {name for name, one in line["states"].items() if one != "online"}
