"""`spotter replay`: play a recording back, never into the live namespace."""

from __future__ import annotations

import json
import math
import signal
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from common.topics import ANY_TOKEN
from spotter_tools.cli.connect import DEFAULT_ENDPOINT, AsJson, Connect, bus
from spotter_tools.cli.fail import fail, needs_extra
from spotter_tools.cli.progress import Progress
from spotter_tools.cli.verify import verify_recording, verify_services

if TYPE_CHECKING:
    from common.recording.player import Pace


def replay(
    files: Annotated[list[Path], typer.Argument(help="Recordings, in order.")],
    rate: Annotated[float, typer.Option(help="2 is twice as fast.")] = 1.0,
    seek: Annotated[float, typer.Option(help="Begin this many seconds in.")] = 0.0,
    loop: Annotated[bool, typer.Option(help="Again and again.")] = False,
    shift: Annotated[bool, typer.Option(help="Make the stamps those of now, so that nothing is too old.")] = True,
    namespace: Annotated[str, typer.Option(help="Where it is played; must have no live services.")] = "replay",
    verify: Annotated[bool, typer.Option("--verify", help="Do not play: decide every verdict again.")] = False,
    service: Annotated[
        list[str] | None,
        typer.Option("--service", help="With --verify: run lidar, radar, camera or infra_lidar over raw bytes."),
    ] = None,
    config: Annotated[Path | None, typer.Option("--config", help="With --service: its configuration.")] = None,
    connect: Connect = DEFAULT_ENDPOINT,
    as_json: AsJson = False,
) -> None:
    """Play recordings on the bus under their own namespace; services and tools follow with --namespace replay."""
    for path in files:
        if not path.exists():
            fail(f"{path}: no such file", code=2)
    if verify:
        verify_services(service, files, config, as_json) if service else verify_recording(files, as_json)
        return
    if service or config:
        fail("--service and --config go with --verify; a service plays raw bytes with --source mcap:FILE", code=2)
    if not rate > 0:
        fail(f"--rate {rate}: must be greater than 0", code=2)
    if not 0.0 <= seek < math.inf:
        fail(f"--seek {seek:g}: expected seconds from the beginning, 0 or more", code=2)
    try:
        from common.recording.player import Pace
    except ImportError:
        needs_extra("replaying needs", "laptop")
    played = _play(files, Pace(rate, seek, loop, shift), connect, namespace)
    if as_json:
        print(json.dumps({"files": [str(path) for path in files], "played": played}))
    else:
        sys.stderr.write(f"  {played} messages played\n")


def _play(files: list[Path], pace: Pace, connect: str, namespace: str) -> int:
    """Returns how many messages went out until the end, or until Ctrl-C."""
    from common.recording.player import Player
    from common.recording.reader import RecordingError

    stop = threading.Event()
    for signum in (signal.SIGINT, signal.SIGTERM):
        signal.signal(signum, lambda *_: stop.set())
    progress, length_s = Progress(), _length_s(files)
    with bus(connect, namespace) as session:
        live = [str(reply.ok.key_expr) for reply in session.liveliness().get(ANY_TOKEN, timeout=1.0) if reply.ok]
        if live:
            fail(f"--namespace {namespace}: {len(live)} live services there; a recording never mixes with live data")
        player = Player(session, files, pace)
        try:
            player.run(stop, lambda into_s: progress.share(into_s, length_s, f"{into_s:.0f} s"))
        except RecordingError as error:
            fail(str(error))
        finally:
            progress.close()
    if not player.played and not stop.is_set():
        fail("nothing to play: no message of ours" + (f" at --seek {pace.seek_s:g} or later" if pace.seek_s else ""))
    return player.played


def _length_s(files: list[Path]) -> float:
    """From the files' indexes; 0 where one has none."""
    from common.recording.reader import RecordingError, span_ns

    try:
        spans = [span_ns(path) for path in files]
    except RecordingError as error:
        fail(str(error))
    return sum(end - start for start, end in spans) / 1e9 if all(map(any, spans)) else 0.0
