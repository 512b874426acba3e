"""A whole site in network namespaces: every boot order, every link broken in every way, bytes and delays per topic.

    python -m benchmarks.system.deploy                  # needs root; about six minutes
    python -m benchmarks.system.deploy faults   # or one part: orders, all-orders, laptop, faults, bandwidth, urgent

Real services on simulated sensors, TLS and access rules on (benchmarks/lab.py).
"""

from __future__ import annotations

import json
import os
import signal
import sys
import tempfile
import time
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import replace
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import lab as site
from common.clock import monotonic_s
from common.topics import SENSOR_TOPICS
from spotter_tools.drill.namespaces import Lab, missing

COUNT_S = 8.0
HOLD_S = 4.0
STAGGER_S = 1.0
LAPTOP = "laptop1"
KILLED_S = 0.3  # from the kill to when it has surely been noticed
SAID = {
    "cut": "cut silently",
    "delay": f"{site.DELAY_S * 1e3:.0f} ms more each way",
    "loss": f"{site.LOSS:.0%} loss each way",
    "throttle": f"{site.MBIT_S:.0f} Mbit/s",
}


class Bench:
    """The lab, a tap on the vehicle and one on the laptop."""

    def __init__(self, stack: ExitStack) -> None:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        self.lab = stack.enter_context(Lab(site.HOSTS, folder))
        site.make_site(self.lab)
        self.vehicle = site.TopicTap(self.lab, "jetson0")
        self.open_laptop()
        stack.callback(self.vehicle.close)
        stack.callback(lambda: self.laptop.close())

    def boot(self, order: Iterable[str] = site.SERVICES, stagger_s: float = 0.0, scenario: str = "empty") -> float:
        """Start the hosts in this order; returns the seconds from the first one to everything online at the laptop.

        The laptop was there before unless the order names it as well.
        """
        begun_s = monotonic_s()
        for host in order:
            if host == LAPTOP:
                self.open_laptop()
            else:
                site.up(self.lab, host, scenario)
            time.sleep(stagger_s)
        return self.laptop.wait(site.all_online, begun_s, 150.0) - begun_s

    def open_laptop(self) -> None:
        """It begins to listen now."""
        self.laptop = site.TopicTap(self.lab, LAPTOP)

    def stop(self) -> None:
        """Switch every host off."""
        self.lab.stop(*site.SERVICES)


def main() -> None:
    """All parts, or those named on the command line."""
    why = missing()
    if why:
        print(f"skipped: {why}")
        return
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that a time limit does not leave the lab behind
    parts = {"orders": print_orders, "all-orders": print_all_orders, "faults": print_faults,
             "laptop": print_laptop_orders, "bandwidth": print_bandwidth, "urgent": print_urgent}  # fmt: skip
    with ExitStack() as stack:
        bench = Bench(stack)
        print(f"start to everything online at the laptop {bench.boot():.1f} s")
        for name in sys.argv[1:] or ["orders", "faults", "bandwidth", "urgent"]:
            parts[name](bench)


def print_orders(bench: Bench) -> None:
    """The three hosts with services, in every order, a second apart; the gate is up."""
    _print_orders(bench, tuple(site.SERVICES)[:3])


def print_all_orders(bench: Bench) -> None:
    """The four hosts with a router, in every order."""
    _print_orders(bench, tuple(site.SERVICES))


def print_laptop_orders(bench: Bench) -> None:
    """The laptop opened before, between and after the others: each of the five once in each place."""
    everybody = (*site.SERVICES, LAPTOP)
    for first in range(len(everybody)):
        bench.laptop.close()
        _print_order(bench, everybody[first:] + everybody[:first])


def _print_orders(bench: Bench, hosts: tuple[str, ...]) -> None:
    print(f"\n{'boot order':<50}{'all online after s':>20}")
    for order in permutations(hosts):
        _print_order(bench, order)


def _print_order(bench: Bench, order: tuple[str, ...]) -> None:
    bench.lab.stop(*(host for host in order if host != LAPTOP))
    print(f"{', '.join(order):<50}{bench.boot(order, STAGGER_S):>20.1f}", flush=True)


def print_faults(bench: Bench) -> None:
    """Every link, every fault: how soon the vehicle and the laptop notice, and how soon all is well again."""
    head = f"{'link of':<9}{'fault':<24}{'heard at':<9}{'notice s':>9}{'recover s':>10}{'verdicts/s':>11}"
    print(f"\n{head}{'gap s':>7}  cause")
    for host in site.HOSTS:
        for fault in site.FAULTS:
            begun_s = bench.vehicle.wait(site.all_online, monotonic_s())
            with site.broken(bench.lab, host, fault):
                time.sleep(HOLD_S)
                ended_s = monotonic_s()
            _print_noticed(
                bench, host, SAID[fault], site.BEHIND.get(host, ()) if fault == "cut" else (), begun_s, ended_s
            )
    for host in site.SERVICES:
        begun_s = bench.vehicle.wait(site.all_online, monotonic_s())
        site.kill_router(bench.lab, host)
        back_s = bench.vehicle.wait(site.all_online, begun_s + KILLED_S)
        heard_s = bench.laptop.wait(site.is_verdict, begun_s + KILLED_S)
        ended_s = max(back_s, heard_s)  # the mending begins with the kill
        # Without its own router the vehicle's fusion hears nobody; and at the end of this interval all are back.
        lost = tuple(SENSOR_TOPICS) if host == "jetson0" else site.BEHIND.get(host, ())
        vehicle = site.Noticed.by(bench.vehicle, lost, begun_s, ended_s, ended_s + back_s - begun_s)
        vehicle = replace(vehicle, wrong=tuple(one for one in vehicle.wrong if "still uses" not in one))
        laptop = site.Noticed.by_laptop(bench.laptop, begun_s, ended_s, ended_s + heard_s - begun_s)
        _print_views(host, "router killed, replaced", vehicle, laptop)


def _print_noticed(bench: Bench, host: str, fault: str, lost: tuple[str, ...], begun_s: float, ended_s: float) -> None:
    back_s = bench.vehicle.wait(site.all_online, ended_s)
    heard_s = bench.laptop.wait(site.is_verdict, ended_s)
    vehicle = site.Noticed.by(bench.vehicle, lost, begun_s, ended_s, back_s)
    _print_views(host, fault, vehicle, site.Noticed.by_laptop(bench.laptop, begun_s, ended_s, heard_s))


def _print_views(host: str, fault: str, vehicle: site.Noticed, laptop: site.Noticed) -> None:
    """Where the laptop noticed nothing, only the vehicle's."""
    for where, seen in (("vehicle", vehicle), ("laptop", laptop)):
        if where == "laptop" and seen.notice_s is None:
            continue
        cause = ", ".join((*seen.causes, *(f"WRONG: {one}" for one in seen.wrong))) or "online throughout"
        print(f"{host:<9}{fault:<24}{where:<9}{_s(seen.notice_s):>9}{_s(seen.recover_s):>10}"
              f"{seen.verdict_hz:>11.0f}{seen.gap_s:>7.2f}  {cause}", flush=True)  # fmt: skip


def print_bandwidth(bench: Bench) -> None:
    """Payload per topic as one laptop gets it, and bytes on each host's link, with the roadside cloud off and on."""
    _enter_scene(bench)
    for title, more in (("without clouds", []), ("with the roadside cloud", ["infra_lidar/points"])):
        before = {host: _link_bytes(bench.lab, host) for host in site.SERVICES}
        counted = _count(bench, more)
        print(f"\n{title}, one laptop at gate0\n{'topic':<30}{'Hz':>8}{'bytes':>10}{'Mbit/s':>10}")
        for key, seen in sorted(counted.items()):
            sizes = seen["bytes"]
            print(f"{key:<30}{len(sizes) / COUNT_S:>8.1f}{np.mean(sizes):>10.0f}{sum(sizes) * 8e-6 / COUNT_S:>10.3f}")
        for host in site.SERVICES:
            now = _link_bytes(bench.lab, host)
            into, out = ((a - b) * 8e-6 / COUNT_S for a, b in zip(now, before[host], strict=True))
            print(f"link of {host:<22}received {into:.2f}, sent {out:.2f} Mbit/s")


def print_urgent(bench: Bench) -> None:
    """Do clouds and pictures delay tracks, verdicts and tokens on a narrow link?"""
    _enter_scene(bench)
    print(f"\n{'link':<22}{'also asked for':<20}{'topic':<28}{'Hz':>6}{'p50 ms':>8}{'p99 ms':>8}{'max ms':>8}")
    cases = [
        ("infra0", mbit_s, large) for mbit_s in (1000.0, site.MBIT_S, 10.0) for large in ("", "infra_lidar/points")
    ]
    cases += [("jetson0", mbit_s, large) for mbit_s in (1000.0, site.MBIT_S, 5.0) for large in ("", "camera/image")]
    for host, mbit_s, large in cases:
        bench.lab.throttle(host, mbit_s)
        counted = _count(bench, [large])
        bench.lab.heal(host)
        key = "infra0/infra_lidar/tracks" if host == "infra0" else "jetson0/fusion/verdict"
        for shown in (key, *(one for one in counted if large and one.endswith(large))):
            ways_ms = counted[shown]["ms"]  # none of what is large: its way is not what is asked
            spread = "".join(f"{np.percentile(ways_ms, q):>8.1f}" for q in (50, 99, 100)) if ways_ms else ""
            print(f"{host}, {mbit_s:<4.0f} Mbit/s    {large or '-':<20}{shown:<28}"
                  f"{len(counted[shown]['bytes']) / COUNT_S:>6.1f}{spread}", flush=True)  # fmt: skip
        bench.vehicle.wait(site.all_online, monotonic_s())
    for large in ("", "infra_lidar/points"):
        print(f"infra0, {site.MBIT_S:.0f} Mbit/s, {large or 'no cloud'}: a killed service is missed after "
              f"{_token_s(bench, large) * 1e3:.0f} ms")  # fmt: skip


def _token_s(bench: Bench, large: str) -> float:
    """From the death of the roadside service to the vehicle's knowing, while its link carries what was asked for."""
    bench.lab.throttle("infra0", site.MBIT_S)
    counting = "counting"
    bench.lab.start(counting, "laptop1", _count_words(bench, [large]))
    time.sleep(COUNT_S / 2)
    begun_s = monotonic_s()
    for pid in bench.lab.pids("infra0", "zenoh.namespace=spotter"):
        os.kill(pid, signal.SIGKILL)
    gone_s = bench.vehicle.wait(site.state("infra_lidar", "disconnected"), begun_s)
    bench.lab.heal("infra0")
    bench.lab.stop(counting)
    bench.vehicle.wait(site.all_online, gone_s)
    return gone_s - begun_s


def _enter_scene(bench: Bench) -> None:
    """From the empty yard to the crossing, so that the topics carry what they usually carry."""
    bench.stop()
    bench.boot(scenario="crossing")


def _count(bench: Bench, more: list[str]) -> dict[str, Any]:
    completed = bench.lab.run("laptop1", _count_words(bench, more))
    counted: dict[str, Any] = json.loads(completed.stdout)
    return counted


def _count_words(bench: Bench, more: list[str]) -> list[str]:
    words = [sys.executable, "-m", "benchmarks.lab_tap", str(bench.lab.folder), "laptop1", "count", str(COUNT_S)]
    return [*words, *filter(None, more)]


def _link_bytes(lab: Lab, host: str) -> tuple[int, int]:
    counters = "/sys/class/net/eth0/statistics/"
    octets = lab.run(host, ["cat", f"{counters}rx_bytes", f"{counters}tx_bytes"]).stdout.split()
    return int(octets[0]), int(octets[1])


def _s(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


if __name__ == "__main__":
    main()
