"""`spotter record`: the bus into MCAP files that Foxglove opens."""

from __future__ import annotations

import importlib.metadata
import json
import signal
import sys
import threading
from pathlib import Path
from typing import Annotated, Any

import typer

from common import topics
from common.cli.connect import DEFAULT_ENDPOINT, AsJson, Connect, Namespace, bus, certified_name
from common.cli.fail import fail
from common.cli.progress import Progress
from common.clock import monotonic_s

NOT_SHOWN = (
    "recording, but nobody is shown it: the site's rules let nobody here speak as `{name}`; "
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
    seconds: Annotated[float, typer.Option(help="Stop by itself; 0 = on Ctrl-C.")] = 0.0,
    keep_free: Annotated[float, typer.Option(help="GB of the disk that are never used.")] = 2.0,
    rotate_mb: Annotated[float, typer.Option(help="A new file after this many MB ...")] = 1000.0,
    rotate_minutes: Annotated[float, typer.Option(help="... or minutes.")] = 60.0,
    foxglove: Annotated[bool, typer.Option(help="Foxglove's own schemas beside ours.")] = True,
    host: Annotated[
        str, typer.Option(envvar="SPOTTER_HOST", help="Under which name the dashboard shows it: certificate, machine.")
    ] = "",
    connect: Connect = DEFAULT_ENDPOINT,
    namespace: Namespace = "spotter",
    as_json: AsJson = False,
) -> None:
    """Record every topic; survives a kill -9 up to the last second. Ctrl-C ends it with index and statistics."""
    try:
        from common.recording.presence import RecorderPresence, this_machine
        from common.recording.recorder import DiskFull, Recorder, RecorderOptions, RecorderStatus
    except ImportError as error:
        fail(f"recording needs the extra `laptop`: {error}")
    if foxglove:
        foxglove = _foxglove_is_here()
    chosen = _chosen(only or [], large) + _raw(raw or [])
    options = RecorderOptions(folder, int(keep_free * 1e9), int(rotate_mb * 1e6), rotate_minutes * 60, foxglove)
    stop = threading.Event()
    for signum in (signal.SIGINT, signal.SIGTERM):
        signal.signal(signum, lambda *_: stop.set())
    started_s, progress = monotonic_s(), Progress()

    name = host or certified_name() or this_machine()
    with bus(connect, namespace) as session, bus(connect, namespace) as witness:
        presence, refused = RecorderPresence(session, name, witness), False

        def tell(status: RecorderStatus) -> None:
            nonlocal refused
            into_s = monotonic_s() - started_s
            if seconds and into_s >= seconds:
                stop.set()
            presence.tell(status)
            if presence.refused and not refused:
                refused = True
                sys.stderr.write(f"  {NOT_SHOWN.format(name=name)}\n")
            progress.share(into_s, seconds, f"{into_s:.0f} s  {presence.words(status)}")

        recorder = Recorder(session, chosen, options, _metadata(session, namespace))
        try:
            recorder.run(stop, tell)
        except DiskFull as error:
            fail(str(error))
        finally:
            recorder.close()
            progress.close()
    if as_json:
        print(json.dumps(vars(recorder.status)))
    else:
        sys.stderr.write(f"  {recorder.status.file}: {presence.words(recorder.status)}\n")


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
    from common.recording.services import who_speaks

    about = {"version": importlib.metadata.version("spotter"), "namespace": namespace}
    return {"spotter": about, **who_speaks(session)}


def _foxglove_is_here() -> bool:
    import importlib.util

    if importlib.util.find_spec("foxglove") is None:
        sys.stderr.write("  without the extra `foxglove`: our messages only, no 3-D scene for Foxglove\n")
        return False
    return True
