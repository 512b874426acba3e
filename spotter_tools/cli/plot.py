"""`spotter plot`: a picture of what is on the bus now, or of a recording."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from spotter_tools.cli.connect import DEFAULT_ENDPOINT, AsJson, Connect, Namespace, bus
from spotter_tools.cli.fail import fail, needs_extra
from spotter_tools.cli.progress import Progress
from spotter_tools.cli.recorded_messages import say_if_cut


def plot(
    what: Annotated[str, typer.Argument(help="A key such as pi0/radar/tracks, or a recording or incident FILE.mcap.")],
    out: Annotated[Path, typer.Argument(help="OUT.png, .svg or .pdf")],
    timeout: Annotated[float, typer.Option(help="Seconds to wait for a message.")] = 5.0,
    start: Annotated[float, typer.Option("--from", min=0.0, help="Of a recording: begin this many seconds in.")] = 0.0,
    end: Annotated[float, typer.Option("--to", help="... and end here; 0 = its end.")] = 0.0,
    connect: Connect = DEFAULT_ENDPOINT,
    namespace: Namespace = "",
    as_json: AsJson = False,
) -> None:
    """Wait for one message of a key and draw it; or draw what happened in a recording."""
    try:
        import spotter_tools.plots.story  # noqa: F401
    except ImportError:
        needs_extra("plotting needs", "plot")
    if end and end <= start:
        fail(f"--to {end:g}: expected more than --from {start:g}", code=2)
    if what.endswith(".mcap") and not Path(what).exists():
        fail(f"{what}: no such file", code=2)
    try:
        if what.endswith(".mcap"):
            _plot_recording(Path(what), out, start, end)
        else:
            _plot_live(what, out, timeout, connect, namespace)
    except OSError as error:
        fail(f"{out}: cannot be written: {error.strerror}")
    except ValueError as error:
        fail(str(error))
    print(json.dumps({"file": str(out)}) if as_json else out)


def _plot_live(key: str, out: Path, timeout_s: float, connect: str, namespace: str) -> None:
    from spotter_tools.plots.message import plot_message

    with bus(connect, namespace) as session:
        key, message = _one_message(session, key, timeout_s)
    plot_message(key, message, out)


def _one_message(session: Any, key: str, timeout_s: float) -> tuple[str, Any]:
    """The first message that comes; asking for it is what makes an on-demand topic be published."""
    import queue

    from common.bus.published import why_silent
    from common.codec import decode
    from common.topics import find_topic

    inbox: queue.Queue[tuple[str, bytes]] = queue.Queue(16)

    def note(sample: Any) -> None:
        if not inbox.full():
            inbox.put_nowait((str(sample.key_expr), sample.payload.to_bytes()))

    subscriber = session.declare_subscriber(key, note)
    try:
        at, payload = inbox.get(timeout=timeout_s)
    except queue.Empty:
        fail(why_silent(session, key) or f"nothing came on {key} within {timeout_s:g} s; --timeout waits longer")
    finally:
        subscriber.undeclare()
    topic = find_topic(at)
    if topic is None:
        fail(f"{at}: not one of the topics; `spotter echo` prints it")
    return at, decode(payload, topic.message, topic.max_bytes)


def _plot_recording(file: Path, out: Path, start_s: float, end_s: float) -> None:
    from common.codec import DecodeError, decode
    from common.recording.elapsed import Elapsed
    from common.recording.reader import expected_messages, read
    from common.topics import find_topic
    from spotter_tools.plots.story import Story, plot_story

    story, progress, elapsed, at_s = Story(), Progress(), Elapsed(), -1.0
    of = expected_messages(file)
    say_if_cut(file)
    for done, recorded in enumerate(read(file)):
        at_s = elapsed.at(recorded.log_ns) / 1e9
        topic = find_topic(recorded.key)
        if topic is None or at_s < start_s:
            continue
        if end_s and at_s > end_s:
            break
        progress.share(done, of, f"{at_s:.0f} s")
        try:
            story.add(at_s - start_s, decode(recorded.payload, topic.message, topic.max_bytes))
        except DecodeError:
            continue
    progress.close()
    if 0.0 <= at_s < start_s:
        raise ValueError(f"{file} is {at_s:.1f} s long; --from {start_s:g} is past its end")
    plot_story(story, f"{file.name}" + (f", from {start_s:g} s" if start_s else ""), out)
