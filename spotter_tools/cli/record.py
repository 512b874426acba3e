"""`spotter record`: the bus into MCAP files that Foxglove opens."""

from __future__ import annotations

import importlib.metadata
import json
import signal
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from common import topics
from common.clock import monotonic_s
from spotter_tools.cli.connect import (
    DEFAULT_ENDPOINT,
    AsJson,
    Connect,
    Namespace,
    bus,
    certified_name,
    namespace_in_use,
    own_name,
)
from spotter_tools.cli.fail import fail, needs_extra
from spotter_tools.cli.progress import Progress

if TYPE_CHECKING:  # the extra `record`, which a bare installation does not have
    from common.recording.recorder import RecorderStatus
    from common.recording.recorder_status import RecorderPresence

NOT_SHOWN = (
    "recording, but the others are not informed: the site's rules let no client here publish as `{name}`; "
    "--host: on a laptop its certificate's name, on a host the host's"
)
LARGE = ("infra_lidar/points", "camera/image")


def record(
    folder: Annotated[Path, typer.Argument(help="Where the files go; made if it is not there.")] = Path("recordings"),
    only: Annotated[
        list[str] | None, typer.Option("--only", help="A product, e.g. fusion/verdict; may be repeated. Default: all.")
    ] = None,
    raw: Annotated[
        list[str] | None,
        typer.Option("--raw", help="Bytes as the device sent them: lidar, radar, camera, infra_lidar; with commas."),
    ] = None,
    large: Annotated[bool, typer.Option(help="Pictures and clouds too (on demand: recording them costs).")] = False,
    seconds: Annotated[float, typer.Option(min=0.0, help="Stop by itself; 0 = on Ctrl-C.")] = 0.0,
    keep_free: Annotated[float, typer.Option(min=0.0, max=1e6, help="GB of the disk that are never used.")] = 2.0,
    rotate_mb: Annotated[float, typer.Option(help="A new file after this many MB ...")] = 1000.0,
    rotate_minutes: Annotated[float, typer.Option(help="... or minutes.")] = 60.0,
    foxglove: Annotated[bool, typer.Option(help="Foxglove's own schemas beside ours.")] = True,
    host: Annotated[
        str,
        typer.Option(
            envvar="SPOTTER_HOST",
            callback=own_name,
            help="Under which name the dashboard shows it: certificate, machine.",
        ),
    ] = "",
    connect: Connect = DEFAULT_ENDPOINT,
    namespace: Namespace = "",
    as_json: AsJson = False,
) -> None:
    """Record every topic; survives a kill -9 up to the last second. Ctrl-C ends it with index and statistics."""
    try:
        from common.recording.recorder import DiskFull, Recorder, RecorderOptions
        from common.recording.recorder_status import RecorderPresence, this_machine
    except ImportError:
        needs_extra("recording needs", "record")
    if foxglove:
        foxglove = _foxglove_is_here()
    chosen = _chosen(only or [], large) + _raw(raw or [])
    options = RecorderOptions(folder, int(keep_free * 1e9), int(rotate_mb * 1e6), rotate_minutes * 60, foxglove)
    stop = threading.Event()
    for signum in (signal.SIGINT, signal.SIGTERM):
        signal.signal(signum, lambda *_: stop.set())

    namespace = namespace_in_use(connect, namespace)
    name = host or certified_name() or this_machine()
    with bus(connect, namespace) as session, bus(connect, namespace) as witness:
        recorder = Recorder(session, chosen, options, _metadata(session, namespace))
        watch = _Watch(RecorderPresence(session, name, witness), name, seconds, stop)
        try:
            recorder.run(stop, watch.report)
        except DiskFull as error:
            watch.failed = str(error)
            fail(str(error))
        except OSError as error:
            watch.failed = f"{error.filename or folder}: {error.strerror}"
            fail(f"{error.filename or folder}: {error.strerror}; nothing can be recorded there")
        finally:
            recorder.close()
            watch.end(recorder.status)
    _conclude(recorder.status, watch.words(recorder.status), as_json)


class _Watch:
    """Shows the progress on dashboard and terminal, and ends the recording after ``seconds`` (0: never)."""

    def __init__(self, presence: RecorderPresence, name: str, seconds: float, stop: threading.Event) -> None:
        self.words = presence.words
        self.failed = ""  # why it has ended, if it was not stopped by the user
        self._presence, self._name = presence, name
        self._seconds, self._stop = seconds, stop
        self._started_s, self._progress = monotonic_s(), Progress()
        self._refusal_reported = False

    def report(self, status: RecorderStatus) -> None:
        """Show the progress of the recording."""
        into_s = monotonic_s() - self._started_s
        if self._seconds and into_s >= self._seconds:
            self._stop.set()
        self._presence.report(status)
        if self._presence.refused and not self._refusal_reported:
            self._refusal_reported = True
            sys.stderr.write(f"  {NOT_SHOWN.format(name=self._name)}\n")
        self._progress.share(into_s, self._seconds, f"{into_s:.0f} s  {self.words(status)}")

    def end(self, status: RecorderStatus) -> None:
        """The recording has ended."""
        self._presence.end(status, self.failed)
        self._progress.close()


def _conclude(status: Any, words: str, as_json: bool) -> None:
    if not status.from_services:
        fail(f"{status.file}: not one message came; `spotter ls` shows who is alive")
    if as_json:
        print(json.dumps(vars(status)))
    else:
        sys.stderr.write(f"  {status.file}: {words}\n")


def _chosen(only: list[str], large: bool) -> list[topics.Topic]:
    table = [*topics.DATA_TOPICS, topics.status_topic("*")]
    unknown = set(only) - {topic.name for topic in topics.DATA_TOPICS}
    if unknown:
        known = ", ".join(topic.name for topic in topics.DATA_TOPICS)
        fail(f"--only {', '.join(sorted(unknown))}: no such product; known: {known}", code=2)
    if only:
        return [topic for topic in table if topic.name in only]
    return [topic for topic in table if large or topic.name not in LARGE]


def _raw(services: list[str]) -> list[topics.Topic]:
    wanted = [name for words in services for name in words.split(",")]
    known = {topic.service: topic for topic in topics.RAW_TOPICS}
    unknown = sorted(set(wanted) - set(known))
    if unknown:
        fail(f"--raw {', '.join(unknown)}: no raw bytes of that; known: {', '.join(known)}", code=2)
    return [known[name] for name in dict.fromkeys(wanted)]


def _metadata(session: Any, namespace: str) -> dict[str, dict[str, str]]:
    """Which services, versions and configurations the recording is of."""
    from common.recording.services import running_services

    about = {"version": importlib.metadata.version("spotter"), "namespace": namespace}
    return {"spotter": about, **running_services(session)}


def _foxglove_is_here() -> bool:
    import importlib.util

    if importlib.util.find_spec("foxglove") is None:
        sys.stderr.write("  without the extra `foxglove`: our messages only, no 3-D scene for Foxglove\n")
        return False
    return True
