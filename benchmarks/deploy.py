"""A whole site in network namespaces: time to notice and to recover per broken link, and bytes per topic and host.

    python -m benchmarks.deploy            # needs root; about four minutes

Real services on simulated sensors, TLS and access rules on; pi0, jetson0 and infra0 with a laptop at jetson0's router.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from itertools import permutations
from pathlib import Path
from typing import Any

import zenoh

from common import topics
from common.codec import DecodeError, decode
from common.drill import namespaces
from common.messages import SystemHealth, Verdict
from common.security import authority
from common.security.router import laptop_config
from common.session import open_session
from common.site import load_site

HOSTS = ("pi0", "jetson0", "infra0", "laptop1", "relay")
SERVICES = {"pi0": ("radar",), "jetson0": ("lidar", "camera", "fusion"), "infra0": ("infra_lidar",)}
SENSORS = ("radar", "lidar", "camera", "infra_lidar")
SPOTTER = str(Path(sys.executable).with_name("spotter"))
SECONDS = 8.0
DELAY_S = 0.1
SETTLE_S = 4.0


def main() -> None:
    why = namespaces.missing()
    if why:
        print(f"skipped: {why}")
        return
    with tempfile.TemporaryDirectory() as folder, namespaces.Lab(HOSTS, Path(folder)) as lab:
        make_site(lab)
        laptop = Laptop(lab)
        begun_s = time.monotonic()
        for host in ("jetson0", "pi0", "infra0"):
            up(lab, host)
        verdict_s = laptop.wait(lambda line: line["kind"] == "verdict") - begun_s
        laptop.wait(online("radar"))
        laptop.wait(online("infra_lidar"), budget_s=150.0)
        print(f"start to first verdict at the laptop {verdict_s:.1f} s")
        print_boot_orders(lab, laptop)
        print_faults(lab, laptop)
        print_bandwidth(lab, laptop)


def print_boot_orders(lab: namespaces.Lab, laptop: Laptop) -> None:
    """Stop all three hosts and start them a second apart, in every order."""
    print(f"\n{'boot order':<34}{'all online after s'}")
    for order in permutations(SERVICES):
        for host in SERVICES:
            lab.stop(host)
        begun_s = time.monotonic()
        for host in order:
            up(lab, host)
            time.sleep(1.0)
        online_s = max(laptop.wait(online(sensor), begun_s, 120.0) for sensor in SENSORS)
        print(f"{', '.join(order):<34}{online_s - begun_s:.1f}", flush=True)


def print_faults(lab: namespaces.Lab, laptop: Laptop) -> None:
    """One fault at a time on a host's link; how long until its sensor leaves online, and until it is back."""
    print(f"\n{'fault':<34}{'notice s':>10}{'recover s':>11}{'verdicts/s':>12}{'  cause'}")
    for host, sensor in (("pi0", "radar"), ("infra0", "infra_lidar")):
        row(laptop, f"{host} cut", sensor, lambda host=host: lab.cut(host), lambda host=host: lab.heal(host))
        row(
            laptop, f"{host} 5 % loss", sensor, lambda host=host: lab.lose(host, 0.05), lambda host=host: lab.heal(host)
        )
        row(
            laptop,
            f"{host} 20 Mbit/s",
            sensor,
            lambda host=host: lab.throttle(host, 20),
            lambda host=host: lab.heal(host),
        )
        row(laptop, f"{host} router killed", sensor, lambda host=host: kill(lab, host), lambda: None)
    lab.stop("pi0")
    lab.start("relay", "relay", [sys.executable, "-m", "benchmarks.deploy", "relay", lab.address("pi0")])
    up(lab, "pi0")
    lab.stop("jetson0")
    begun_s = time.monotonic()
    up(lab, "jetson0", "behind.toml")
    laptop.wait(online("radar"), begun_s)
    laptop.wait(online("camera"), begun_s)
    row(laptop, "pi0 100 ms each way (relay)", "radar", lambda: None, lambda: None)


def row(
    laptop: Laptop,
    name: str,
    sensor: str,
    break_it: Callable[[], None],
    mend: Callable[[], None],
    settle_s: float = 4.0,
) -> None:
    laptop.wait(online(sensor), time.monotonic())
    broken_s = time.monotonic()
    break_it()
    time.sleep(SETTLE_S)
    seen = [line for line in laptop.since(broken_s) if line["kind"] == "health" and line[sensor][0] != "online"]
    mended_s = time.monotonic()
    mend()
    back_s = laptop.wait(online(sensor), mended_s, 60.0)
    notice = f"{seen[0]['at'] - broken_s:.2f}" if seen else "-"
    recover = f"{back_s - mended_s:.2f}" if seen else "-"
    rate = sum(line["kind"] == "verdict" for line in laptop.since(broken_s)) / (time.monotonic() - broken_s)
    cause = ", ".join(sorted({line[sensor][1] for line in seen})) or "online throughout"
    print(f"{name:<34}{notice:>10}{recover:>11}{rate:>12.0f}  {cause}", flush=True)


def print_bandwidth(lab: namespaces.Lab, laptop: Laptop) -> None:
    """Payload per topic as one subscriber gets it, and bytes on each host's link, clouds off and on."""
    words = [sys.executable, "-m", "benchmarks.deploy", "count", str(lab.folder)]
    for title, more in (("without clouds", []), ("with the cloud", ["points"])):
        before = {host: link_bytes(lab, host) for host in SERVICES}
        counted = json.loads(lab.run("laptop1", [*words, *more]).stdout)
        print(f"\n{title}, one laptop at jetson0\n{'topic':<30}{'Hz':>8}{'bytes':>10}{'kbit/s':>10}")
        for key, (count, size) in sorted(counted.items()):
            print(f"{key:<30}{count / SECONDS:>8.1f}{size / count:>10.0f}{size * 8e-3 / SECONDS:>10.0f}")
        for host in SERVICES:
            received, sent = (after - b for after, b in zip(link_bytes(lab, host), before[host], strict=True))
            print(
                f"link of {host:<22}received {received * 8e-6 / SECONDS:.2f}, sent {sent * 8e-6 / SECONDS:.2f} Mbit/s"
            )
    for mbit_s in (20, 10):  # the second is less than the cloud needs
        lab.throttle("infra0", mbit_s)
        begun_s = time.monotonic()
        lab.run("laptop1", [*words, "points"])
        states = Counter(line["infra_lidar"][0] for line in laptop.since(begun_s) if line["kind"] == "health")
        lab.heal("infra0")
        laptop.wait(online("infra_lidar"), time.monotonic())
        print(f"the cloud over {mbit_s} Mbit/s at infra0: infra_lidar in the health messages {dict(states)}")


def make_site(lab: namespaces.Lab) -> None:
    authority.init(lab.folder / "keys", "spotter")
    for name, pi_address in (("site.toml", lab.address("pi0")), ("behind.toml", lab.address("relay"))):
        lines = []
        for host, services in SERVICES.items():
            address = pi_address if host == "pi0" else lab.address(host)
            lines += [f"[hosts.{host}]", f'address = "{address}"']
            lines += [f"[hosts.{host}.services.{one}]" for one in services]
        (lab.folder / name).write_text("\n".join(lines) + "\n")
    for host in SERVICES:
        authority.issue(lab.folder / "keys", host, "host", (lab.address(host), lab.address("relay")))
    authority.issue(lab.folder / "keys", "laptop1", "laptop")


def up(lab: namespaces.Lab, host: str, site: str = "site.toml") -> None:
    words = [
        SPOTTER,
        "up",
        host,
        "--sim",
        "empty" if host != "infra0" else "crossing",
        "--site",
        str(lab.folder / site),
    ]
    lab.start(host, host, words)


def kill(lab: namespaces.Lab, host: str) -> None:
    for pid in lab.pids(host, "router"):
        os.kill(pid, signal.SIGKILL)


def link_bytes(lab: namespaces.Lab, host: str) -> tuple[int, int]:
    counters = "/sys/class/net/eth0/statistics/"
    told = lab.run(host, ["cat", f"{counters}rx_bytes", f"{counters}tx_bytes"]).stdout.split()
    return int(told[0]), int(told[1])


def online(sensor: str) -> Callable[[dict[str, Any]], bool]:
    return lambda line: line["kind"] == "health" and line[sensor][0] == "online"


class Laptop:
    """A process in the laptop's namespace that tells what it hears."""

    def __init__(self, lab: namespaces.Lab) -> None:
        words = ["ip", "netns", "exec", lab.space("laptop1"), sys.executable, "-m", "benchmarks.deploy", "listen"]
        self._process = subprocess.Popen([*words, str(lab.folder)], stdout=subprocess.PIPE)
        self._lines: list[dict[str, Any]] = []
        self._changed = threading.Condition()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            with self._changed:
                self._lines.append(json.loads(line))
                self._changed.notify_all()

    def wait(self, wanted: Callable[[dict[str, Any]], bool], since_s: float = 0.0, budget_s: float = 60.0) -> float:
        deadline_s = time.monotonic() + budget_s
        with self._changed:
            while True:
                for line in self._lines:
                    if line["at"] >= since_s and wanted(line):
                        return float(line["at"])
                if time.monotonic() > deadline_s:
                    raise TimeoutError(f"not heard within {budget_s} s; last: {self._lines[-2:]}")
                self._changed.wait(1.0)

    def since(self, start_s: float) -> list[dict[str, Any]]:
        with self._changed:
            return [line for line in self._lines if line["at"] >= start_s]


def listen(folder: Path) -> None:
    """In the laptop's namespace: health and verdicts as JSON lines."""
    session = as_laptop(folder)
    one_at_a_time = threading.Lock()

    def tell(sample: zenoh.Sample) -> None:
        topic = topics.find_topic(str(sample.key_expr))
        try:
            message = decode(sample.payload.to_bytes(), topic.message) if topic else None
        except DecodeError:
            return
        line: dict[str, Any] = {"at": time.monotonic(), "kind": "verdict"}
        if isinstance(message, SystemHealth):
            line |= {"kind": "health", **{name: (one.state, one.cause) for name, one in message.sensors.items()}}
        elif isinstance(message, Verdict):
            line |= {"level": message.level, "permission": message.permission}
        with one_at_a_time:
            print(json.dumps(line), flush=True)

    kept = [session.declare_subscriber(t.any_host, tell) for t in (topics.FUSION_VERDICT, topics.FUSION_HEALTH)]
    threading.Event().wait()
    del kept


def count(folder: Path, on_demand: bool) -> None:
    """In the laptop's namespace: messages and bytes by key, as one JSON object."""
    session, seen = as_laptop(folder), {}
    wanted = [t for t in topics.DATA_TOPICS if not t.on_demand or (on_demand and t is topics.INFRA_POINTS)]

    def note(sample: zenoh.Sample) -> None:
        number, size = seen.get(str(sample.key_expr), (0, 0))
        seen[str(sample.key_expr)] = (number + 1, size + len(sample.payload.to_bytes()))

    kept = [session.declare_subscriber(topic.any_host, note) for topic in [*wanted, topics.status_topic("*")]]
    time.sleep(SECONDS)
    print(json.dumps(seen))
    del kept
    session.close()


def as_laptop(folder: Path) -> zenoh.Session:
    return open_session(laptop_config(load_site(folder / "site.toml"), "laptop1", folder / "keys", "jetson0"))


async def relay(target: str) -> None:
    """Forward with a delay in each direction: this kernel has no netem."""

    async def pump(source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
        waiting: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()

        async def deliver() -> None:
            while True:
                due_s, data = await waiting.get()
                await asyncio.sleep(max(0.0, due_s - time.monotonic()))
                sink.write(data)
                await sink.drain()

        delivering = asyncio.create_task(deliver())
        while data := await source.read(65_536):
            waiting.put_nowait((time.monotonic() + DELAY_S, data))
        delivering.cancel()
        sink.close()

    async def serve(port: int) -> None:
        async def accept(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            there, back = await asyncio.open_connection(target, port)
            await asyncio.gather(pump(reader, back), pump(there, writer))

        await (await asyncio.start_server(accept, "0.0.0.0", port)).serve_forever()

    await serve(7448)


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["listen", folder]:
            listen(Path(folder))
        case ["count", folder, *more]:
            count(Path(folder), bool(more))
        case ["relay", target]:
            asyncio.run(relay(target))
        case _:
            main()
