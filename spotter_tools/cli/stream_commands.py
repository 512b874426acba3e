"""`spotter echo | hz`: messages of a key expression, and how often they come."""

from __future__ import annotations

import queue
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from itertools import pairwise
from typing import Annotated

import msgpack
import msgspec
import typer
import zenoh

from common import topics
from common.bus.published import why_silent
from common.codec import DecodeError, decode, to_builtins
from spotter_tools.cli.connect import DEFAULT_ENDPOINT, AsJson, Connect, Namespace, bus
from spotter_tools.cli.fail import fail
from spotter_tools.cli.newest import keep_newest
from spotter_tools.cli.render import readable
from spotter_tools.cli.selection import Selection, select

NOBODY_AFTER_S = 4.0  # of silence, then check whether any service publishes the key


def echo(
    key: Annotated[str, typer.Argument(help="Key expression, e.g. '*/radar/tracks' or 'jetson0/**'.")],
    count: Annotated[int, typer.Option("--count", "-n", min=0, help="Stop after this many; 0 = never.")] = 0,
    connect: Connect = DEFAULT_ENDPOINT,
    namespace: Namespace = "",
    as_json: AsJson = False,
) -> None:
    """Print messages as they arrive, newest first when they come too fast."""
    selection, shown = select(key), 0
    arrived: queue.Queue[zenoh.Sample] = queue.Queue(100)
    with bus(connect, namespace) as session:
        _subscribe(session, selection, lambda sample: keep_newest(arrived, sample))
        while not count or shown < count:
            try:
                _print_sample(arrived.get(timeout=NOBODY_AFTER_S), as_json)
            except queue.Empty:
                _fail_if_nobody(session, key)
            else:
                shown += 1


def _subscribe(session: zenoh.Session, selection: Selection, take: Callable[[zenoh.Sample], None]) -> None:
    """Subscribe for as long as the session lives; says on stderr what was left out."""
    if selection.note:
        sys.stderr.write(f"spotter: {selection.note}\n")

    def chosen(sample: zenoh.Sample) -> None:
        if selection.includes(str(sample.key_expr)):
            take(sample)

    for expression in selection.expressions:
        session.declare_subscriber(expression, chosen)


def _fail_if_nobody(session: zenoh.Session, key: str) -> None:
    reason = why_silent(session, key)
    if reason:
        fail(reason)


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
    seconds: Annotated[float, typer.Option(min=0.05, help="Window, and how often a line is printed.")] = 2.0,
    count: Annotated[int, typer.Option("--count", "-n", min=0, help="Stop after this many lines; 0 = never.")] = 0,
    connect: Connect = DEFAULT_ENDPOINT,
    namespace: Namespace = "",
    as_json: AsJson = False,
) -> None:
    """Rate, bandwidth and largest gap of each matching key."""
    selection = select(key)
    arrivals: dict[str, deque[tuple[float, int]]] = {}
    lock = threading.Lock()

    def receive(sample: zenoh.Sample) -> None:
        with lock:
            window = arrivals.setdefault(str(sample.key_expr), deque(maxlen=100_000))
            window.append((time.monotonic(), len(sample.payload)))

    with bus(connect, namespace) as session:
        _subscribe(session, selection, receive)
        printed, heard_s = 0, time.monotonic()
        while not count or printed < count:
            time.sleep(seconds)
            printed += 1
            with lock:
                windows, arrivals = arrivals, {}
            if windows:
                heard_s = time.monotonic()
            elif time.monotonic() - heard_s >= NOBODY_AFTER_S or printed == count:
                _fail_if_nobody(session, key)
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
