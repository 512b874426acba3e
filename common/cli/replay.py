"""`spotter replay`: play a recording back, never into the live namespace."""

from __future__ import annotations

import signal
import sys
import threading
from pathlib import Path
from typing import Annotated

import typer

from common.cli.connect import DEFAULT_ENDPOINT, Connect, bus
from common.cli.fail import fail
from common.topics import ANY_TOKEN


def replay(
    files: Annotated[list[Path], typer.Argument(help="Recordings, in order.")],
    rate: Annotated[float, typer.Option(help="2 is twice as fast.")] = 1.0,
    seek: Annotated[float, typer.Option(help="Begin this many seconds in.")] = 0.0,
    loop: Annotated[bool, typer.Option(help="Again and again.")] = False,
    shift: Annotated[bool, typer.Option(help="Make the stamps those of now, so that nothing is too old.")] = True,
    namespace: Annotated[str, typer.Option(help="Where it is played; must have no live services.")] = "replay",
    verify: Annotated[bool, typer.Option("--verify", help="Do not play: decide every verdict again.")] = False,
    connect: Connect = DEFAULT_ENDPOINT,
) -> None:
    """Play recordings on the bus under their own namespace; services and tools follow with --namespace replay."""
    if verify:
        verify_recording(files)
        return
    try:
        from common.recording.player import Pace, Player
        from common.recording.reader import RecordingError
    except ImportError as error:
        fail(f"replaying needs the extra `laptop`: {error}")
    if not rate > 0:
        fail(f"--rate {rate}: must be greater than 0", code=2)
    for path in files:
        if not path.is_file():
            fail(f"{path}: no such file", code=2)
    stop = threading.Event()
    for signum in (signal.SIGINT, signal.SIGTERM):
        signal.signal(signum, lambda *_: stop.set())

    def tell(into_s: float) -> None:
        sys.stderr.write(f"\r  {into_s:8.1f} s")

    with bus(connect, namespace) as session:
        live = [str(reply.ok.key_expr) for reply in session.liveliness().get(ANY_TOKEN, timeout=1.0) if reply.ok]
        if live:
            fail(f"--namespace {namespace}: {len(live)} live services there; a recording never mixes with live data")
        player = Player(session, files, Pace(rate, seek, loop, shift))
        try:
            player.run(stop, tell)
        except RecordingError as error:
            fail(str(error))
    sys.stderr.write(f"\n  {player.played} messages played\n")


def verify_recording(files: list[Path]) -> None:
    """Print what was checked; exit code 1 with the first difference when the recording does not hold."""
    from common.recording.reader import RecordingError, read
    from services.jetson.fusion.verify import verify

    for path in files:
        if not path.is_file():
            fail(f"{path}: no such file", code=2)
    try:
        report = verify((one.key, one.payload) for path in files for one in read(path))
    except RecordingError as error:
        fail(str(error))
    checked = (
        f"{report.decided_again} of {report.verdicts} verdicts decided again, {report.inputs_checked} inputs checked"
    )
    if report.difference:
        fail(f"{report.difference} ({checked} before that)")
    if not report.decided_again:
        fail("nothing to verify: the recording has no fusion/trace beside its verdicts")
    print(f"identical: {checked}")
