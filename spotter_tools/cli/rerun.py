"""`spotter rerun`: the running system, or a recording, in Rerun: 3-D scene, picture, plots, log."""

from __future__ import annotations

import json
import queue
import signal
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from common import topics
from common.clock import monotonic_s
from common.topics import CAMERA_IMAGE, DATA_TOPICS, INFRA_POINTS
from spotter_tools.cli.connect import DEFAULT_ENDPOINT, AsJson, Connect, Namespace, bus
from spotter_tools.cli.fail import fail, needs_extra
from spotter_tools.cli.newest import keep_newest
from spotter_tools.cli.progress import Progress

BACKLOG = 1000  # messages that wait for a slow Rerun before the oldest is dropped
TICK_S = 0.2
Arrivals = Iterator[tuple[str, bytes]]


def rerun(
    recording: Annotated[Path | None, typer.Argument(help="A recording or incident; without it the live bus.")] = None,
    save: Annotated[Path | None, typer.Option("--save", help="Into OUT.rrd instead of the viewer.")] = None,
    seconds: Annotated[float, typer.Option(min=0.0, help="Of the live bus: end after so long; 0 = on Ctrl-C.")] = 0.0,
    large: Annotated[bool, typer.Option(help="Pictures and clouds too.")] = True,
    connect: Connect = DEFAULT_ENDPOINT,
    namespace: Namespace = "",
    as_json: AsJson = False,
) -> None:
    """Show the bus or a recording in Rerun's viewer, or write a file that it opens."""
    try:
        import rerun as rr

        from common.recording.rerun_scene import RerunLog
    except ImportError:
        needs_extra("this needs", "rerun")
    if recording is not None and not recording.exists():
        fail(f"{recording}: no such file", code=2)
    if save is not None and save.exists():
        fail(f"{save}: is already there", code=2)
    stream = rr.RecordingStream("spotter")
    if save is not None:
        stream.save(save)
    else:
        stream.spawn()
    log = RerunLog(stream)
    for key, payload in _recorded(recording) if recording is not None else _live(connect, namespace, seconds, large):
        log.add(key, payload)
    stream.flush()
    if as_json:
        print(json.dumps({"file": str(save or ""), "logged": log.logged, "undecodable": log.undecodable}))
    else:
        print(f"{save or 'viewer'}: {log.logged} messages, {log.undecodable} could not be decoded")


def _recorded(path: Path) -> Arrivals:
    try:
        from common.recording.reader import RecordingError, expected_messages, files_in, read
    except ImportError:
        needs_extra("reading recordings needs", "record")
    progress, done = Progress(), 0
    try:
        of = sum(map(expected_messages, files_in(path)))
        for one in (one for file in files_in(path) for one in read(file)):
            done += 1
            progress.share(done, of)
            yield one.key, one.payload
    except RecordingError as error:
        fail(str(error))
    finally:
        progress.close()


def _live(connect: str, namespace: str, seconds: float, large: bool) -> Arrivals:
    """What arrives until Ctrl-C or the time is over; the oldest is dropped when Rerun is slower than the bus."""
    stop, arrivals = threading.Event(), queue.Queue[tuple[str, bytes]](BACKLOG)
    for signum in (signal.SIGINT, signal.SIGTERM):
        signal.signal(signum, lambda *_: stop.set())

    def note(sample: Any) -> None:
        keep_newest(arrivals, (str(sample.key_expr), sample.payload.to_bytes()))

    wanted = [topic for topic in DATA_TOPICS if not topic.on_demand] + [topics.status_topic("*")]
    wanted += [CAMERA_IMAGE, INFRA_POINTS] if large else []
    until_s = monotonic_s() + seconds if seconds else float("inf")
    with bus(connect, namespace) as session:
        subscribers = [session.declare_subscriber(topic.any_host, note) for topic in wanted]
        if not seconds:
            sys.stderr.write("  Ctrl-C ends\n")
        while not stop.is_set() and monotonic_s() < until_s:
            try:
                yield arrivals.get(timeout=TICK_S)
            except queue.Empty:
                continue
        for subscriber in subscribers:
            subscriber.undeclare()
