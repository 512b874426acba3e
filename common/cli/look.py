"""`spotter ls | echo | hz | health`: look at what is on the bus."""

from __future__ import annotations

import queue
import sys
import threading
import time
from collections import deque
from itertools import pairwise
from typing import Annotated, Any

import msgpack
import msgspec
import typer
import zenoh

from common import topics
from common.cli.connect import DEFAULT_ENDPOINT, AsJson, Connect, Namespace, bus
from common.cli.fail import fail
from common.cli.render import health_lines, readable, reason_lines, verdict_line
from common.codec import DecodeError, decode, to_builtins
from common.messages import ServiceInfo, ServiceStatus, SystemHealth, Verdict
from common.session import plain

QUERY_TIMEOUT_S = 1.0
NO_VERDICT_AFTER_S = topics.FUSION_VERDICT.age_limit_s or 0.25


def ls(connect: Connect = DEFAULT_ENDPOINT, namespace: Namespace = "spotter", as_json: AsJson = False) -> None:
    """Who is alive, from the liveliness tokens, with version, state and reason."""
    with bus(connect, namespace) as session:
        tokens = sorted(
            {
                str(reply.ok.key_expr)
                for reply in session.liveliness().get(topics.ANY_TOKEN, timeout=1.0)
                if reply.ok is not None
            }
        )
        rows = [_row(session, *topics.parse_token(token)) for token in tokens]
    if as_json:
        for row in rows:
            print(msgspec.json.encode(row).decode())
        return
    if not rows:
        print("nobody is there: no liveliness token on this router")
    for row in rows:
        state = f"{row['state']}" + (f" ({row['reason']})" if row["reason"] else "")
        print(f"{row['host'] + '/' + row['service']:<24} {row['instance']:<9} {row['version']:<8} {state}")


def _row(session: zenoh.Session, host: str, service: str, instance: str) -> dict[str, Any]:
    info = _query(session, topics.info_key(host, service), ServiceInfo, instance)
    status = _query(session, topics.status_topic(service).key(host), ServiceStatus, instance)
    return {
        "host": host,
        "service": service,
        "instance": instance,
        "version": info.version if info else "?",
        "config_hash": info.config_hash if info else "?",
        "pid": info.pid if info else None,
        "state": status.state if status else "no answer",
        "reason": status.reason if status else "the process is there but does not answer",
    }


def _query(session: zenoh.Session, key: str, message_type: Any, instance: str) -> Any:
    """The reply of this very instance, or None."""
    target = zenoh.QueryTarget.ALL
    for reply in session.get(key, timeout=QUERY_TIMEOUT_S, target=target, consolidation=zenoh.ConsolidationMode.NONE):
        if reply.ok is None:
            continue
        try:
            message = decode(reply.ok.payload.to_bytes(), message_type)
        except DecodeError:
            continue
        if message.instance == instance:
            return message
    return None


def echo(
    key: Annotated[str, typer.Argument(help="Key expression, e.g. '*/radar/tracks' or 'jetson0/**'.")],
    count: Annotated[int, typer.Option("--count", "-n", help="Stop after this many; 0 = never.")] = 0,
    connect: Connect = DEFAULT_ENDPOINT,
    namespace: Namespace = "spotter",
    as_json: AsJson = False,
) -> None:
    """Print messages as they arrive, newest first when they come too fast."""
    expression = _checked(key)
    with bus(connect, namespace) as session:
        subscriber = session.declare_subscriber(expression, zenoh.handlers.RingChannel(100))
        for shown, sample in enumerate(subscriber, start=1):
            _print_sample(sample, as_json)
            if count and shown >= count:
                return


def _checked(key: str) -> zenoh.KeyExpr:
    try:
        return zenoh.KeyExpr(key)
    except zenoh.ZError as error:
        fail(f"{key!r} is no key expression: {plain(error)}")


def _print_sample(sample: zenoh.Sample, as_json: bool) -> None:
    key, payload = str(sample.key_expr), sample.payload.to_bytes()
    topic = topics.find_topic(key)
    try:
        content = to_builtins(decode(payload, topic.message)) if topic else msgpack.unpackb(payload)
    except (DecodeError, ValueError, msgpack.UnpackException) as error:
        content = {"error": str(error), "bytes": len(payload)}
    if as_json:
        print(msgspec.json.encode({"key": key, "message": content}, enc_hook=repr).decode())
    else:
        print(f"{key}\n{readable(content)}")
    sys.stdout.flush()


def hz(
    key: Annotated[str, typer.Argument(help="Key expression.")],
    seconds: Annotated[float, typer.Option(help="Window, and how often a line is printed.")] = 2.0,
    count: Annotated[int, typer.Option("--count", "-n", help="Stop after this many lines; 0 = never.")] = 0,
    connect: Connect = DEFAULT_ENDPOINT,
    namespace: Namespace = "spotter",
    as_json: AsJson = False,
) -> None:
    """Rate, bandwidth and largest gap of each matching key."""
    expression = _checked(key)
    arrivals: dict[str, deque[tuple[float, int]]] = {}
    lock = threading.Lock()

    def receive() -> None:
        try:
            for sample in subscriber:
                with lock:
                    arrivals.setdefault(str(sample.key_expr), deque(maxlen=100_000)).append(
                        (time.monotonic(), len(sample.payload))
                    )
        except zenoh.ZError:
            return

    with bus(connect, namespace) as session:
        subscriber = session.declare_subscriber(expression, zenoh.handlers.FifoChannel(4096))
        threading.Thread(target=receive, daemon=True).start()
        printed = 0
        while not count or printed < count:
            time.sleep(seconds)
            printed += 1
            with lock:
                windows, arrivals = arrivals, {}
            _print_rates(windows, seconds, as_json)


def _print_rates(windows: dict[str, deque[tuple[float, int]]], seconds: float, as_json: bool) -> None:
    if not windows:
        print("{}" if as_json else f"nothing within {seconds:g} s")
    for key, arrivals in sorted(windows.items()):
        times_s = [time_s for time_s, _ in arrivals]
        gaps_s = [b - a for a, b in pairwise(times_s)]
        rate_hz = len(times_s) / seconds
        kib_s = sum(size for _, size in arrivals) / seconds / 1024
        gap_ms = 1e3 * max(gaps_s, default=seconds)
        if as_json:
            row = {"key": key, "rate_hz": rate_hz, "kib_per_s": kib_s, "largest_gap_ms": gap_ms}
            print(msgspec.json.encode(row).decode())
        else:
            print(f"{key:<36} {rate_hz:7.1f} Hz {kib_s:9.1f} KiB/s   largest gap {gap_ms:6.0f} ms")
    sys.stdout.flush()


def health(
    watch: Annotated[bool, typer.Option("--watch", "-w", help="Go on, a block on every change.")] = False,
    connect: Connect = DEFAULT_ENDPOINT,
    namespace: Namespace = "spotter",
    as_json: AsJson = False,
) -> None:
    """Verdict with its reason, and every sensor's state. Exit code 1 when there is no verdict."""
    inbox: queue.Queue[tuple[str, bytes]] = queue.Queue(maxsize=1000)
    with bus(connect, namespace) as session:
        subscribers = [
            session.declare_subscriber(topic.any_host, lambda sample: _offer(inbox, sample))
            for topic in (topics.FUSION_VERDICT, topics.FUSION_HEALTH)
        ]
        seen = _watch_health(inbox, watch, as_json)
        for subscriber in subscribers:
            subscriber.undeclare()
    if not seen:
        raise SystemExit(1)


def _offer(inbox: queue.Queue[tuple[str, bytes]], sample: zenoh.Sample) -> None:
    try:
        inbox.put_nowait((str(sample.key_expr), sample.payload.to_bytes()))
    except queue.Full:
        return  # the terminal is stuck; newer ones will come


def _watch_health(inbox: queue.Queue[tuple[str, bytes]], watch: bool, as_json: bool) -> bool:
    """Print blocks as they change; returns whether a verdict was seen last."""
    verdict: Verdict | None = None
    system: SystemHealth | None = None
    shown = ""
    last_verdict_s = time.monotonic()
    first_deadline_s = time.monotonic() + 2.0
    while True:
        try:
            key, payload = inbox.get(timeout=0.05)
        except queue.Empty:
            pass
        else:
            if key.endswith("/verdict"):
                verdict, last_verdict_s = decode(payload, Verdict), time.monotonic()
            else:
                system = decode(payload, SystemHealth)
        silent_s = time.monotonic() - last_verdict_s
        if verdict is not None and silent_s > NO_VERDICT_AFTER_S:
            verdict = None
        waiting = (verdict is None or system is None) and time.monotonic() < first_deadline_s
        if waiting:
            continue
        block = _block(verdict, system, silent_s, as_json)
        if _without_ages(block) != shown:
            shown = _without_ages(block)
            print(block, flush=True)
        if not watch:
            return verdict is not None


def _block(verdict: Verdict | None, system: SystemHealth | None, silent_s: float, as_json: bool) -> str:
    if as_json:
        row = {
            "verdict": to_builtins(verdict) if verdict else None,
            "health": to_builtins(system) if system else None,
        }
        return msgspec.json.encode(row).decode()
    lines = [verdict_line(verdict, silent_s), *(reason_lines(verdict) if verdict else [])]
    lines += health_lines(system) if system and verdict else ["health unknown: fusion does not publish"]
    return "\n".join(lines)


def _without_ages(block: str) -> str:
    """What is compared to decide whether something changed: ages and rates always change."""
    return "".join(character for character in block if not character.isdigit())
