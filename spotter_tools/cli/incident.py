"""`spotter incident list | save | open | verify`: what the blackboxes of all hosts have kept."""

from __future__ import annotations

import json
import tempfile
import time
from pathlib import Path
from typing import Annotated, Any

import typer
import zenoh

from spotter_tools.cli.connect import DEFAULT_ENDPOINT, AsJson, Connect, Namespace, bus
from spotter_tools.cli.fail import fail
from spotter_tools.cli.progress import Progress

QUERY_TIMEOUT_S = 3.0
NO_BLACKBOX = "no blackbox answers; is spotter-blackbox running on the hosts?"

app = typer.Typer(name="incident", help="Incidents: what every host kept around an alarm.", no_args_is_help=True)


@app.command("list")
def list_incidents(connect: Connect = DEFAULT_ENDPOINT, namespace: Namespace = "", as_json: AsJson = False) -> None:
    """Names of the kept incidents, and which hosts have a capsule of each."""
    with bus(connect, namespace) as session:
        answers = _incidents_of_hosts(session)
    if not answers:
        fail(NO_BLACKBOX)
    hosts = _hosts_by_incident(answers)
    if as_json:
        print(json.dumps(hosts))
        return
    if not hosts:
        print(f"no incidents yet; the blackbox answers on {', '.join(sorted(answers))}")
    for name, on in sorted(hosts.items()):
        print(f"{name:<50} {', '.join(sorted(on))}")


@app.command()
def save(
    why: Annotated[str, typer.Argument(help="A few words for the reader.")] = "asked for",
    connect: Connect = DEFAULT_ENDPOINT,
    namespace: Namespace = "",
    as_json: AsJson = False,
) -> None:
    """Save the last seconds of every host now."""
    selector = zenoh.Selector("*/blackbox/save", zenoh.Parameters({"why": why, "at_ns": str(time.time_ns())}))
    with bus(connect, namespace) as session:
        answers = [reply.ok for reply in session.get(selector, timeout=QUERY_TIMEOUT_S) if reply.ok is not None]
    if not answers:
        fail(NO_BLACKBOX)
    for answer in answers:
        host, said = str(answer.key_expr).partition("/")[0], json.loads(answer.payload.to_bytes())
        note = "" if said["new"] else "   (open already; your words are added)"
        print(json.dumps({"host": host, **said}) if as_json else f"{host}: {said['incident']}{note}")


@app.command("open")
def open_incident(
    name: Annotated[str, typer.Argument(help="As `spotter incident list` prints it.")],
    out: Annotated[Path | None, typer.Option(help="The merged file; default <name>.mcap here.")] = None,
    fusion_host: Annotated[str, typer.Option(help="The host whose clock the merged file is on.")] = "jetson0",
    connect: Connect = DEFAULT_ENDPOINT,
    namespace: Namespace = "",
    as_json: AsJson = False,
) -> None:
    """Fetch the capsules of all hosts and merge them into one file on one clock."""
    from services.blackbox.trigger import NAME

    if not NAME.match(name):
        fail(f"{name!r} is no incident's name", code=2)
    target = out or Path(f"{name}.mcap")
    if target.exists():
        fail(f"{target} is there already")
    with bus(connect, namespace) as session, tempfile.TemporaryDirectory() as folder:
        hosts = _hosts_by_incident(_incidents_of_hosts(session)).get(name, [])
        if not hosts:
            fail(f"no host has {name}; see `spotter incident list`")
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            capsules = {host: _fetch(session, host, name, Path(folder)) for host in hosts}
            clocks = _merged(capsules, fusion_host, target)
        except OSError as error:
            fail(f"{error.filename or target}: {error.strerror}; {name} was not opened and nothing of it is left here")
    if as_json:
        print(json.dumps({"file": str(target), "clocks": {host: vars(clock) for host, clock in clocks.items()}}))
        return
    for host, clock in sorted(clocks.items()):
        if clock.offset_s is None or clock.bound_s is None:
            print(f"{host}: clock offset not known, stamps as they are")
        else:
            print(f"{host}: clock {clock.offset_s * 1e3:+.2f} ms, true within {clock.bound_s * 1e3:.2f} ms")
    print(target)


@app.command()
def verify(
    file: Annotated[Path, typer.Argument(help="A merged incident or any recording with fusion/trace.")],
    as_json: AsJson = False,
) -> None:
    """Decide every verdict again from what was recorded; the same as `spotter replay --verify`."""
    from spotter_tools.cli.verify import verify_recording

    verify_recording([file], as_json)


def _merged(capsules: dict[str, Path], fusion_host: str, target: Path) -> dict[str, Any]:
    """The clocks of the hosts; ends the command when a capsule came damaged."""
    from common.recording.reader import RecordingError
    from services.blackbox.capsule import merge

    try:
        return merge(capsules, fusion_host, target)
    except RecordingError as error:
        damage = str(error).rpartition("/")[2]  # without the folder that they were fetched into
        fail(f"the capsules cannot be merged: {damage}")


def _incidents_of_hosts(session: zenoh.Session) -> dict[str, list[str]]:
    """Names of the kept incidents by host, of every blackbox that answers."""
    found: dict[str, list[str]] = {}
    for reply in session.get("*/blackbox/incidents", timeout=QUERY_TIMEOUT_S):
        if reply.ok is not None:
            names: Any = json.loads(reply.ok.payload.to_bytes())
            found[str(reply.ok.key_expr).split("/")[0]] = [str(name) for name in names]
    return found


def _hosts_by_incident(names_by_host: dict[str, list[str]]) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for host, names in names_by_host.items():
        for name in names:
            found.setdefault(name, []).append(host)
    return found


def _fetch(session: zenoh.Session, host: str, name: str, folder: Path) -> Path:
    """A host's capsule, part by part."""
    from services.blackbox.server import PART_BYTES

    path, progress = folder / f"{host}.mcap", Progress()
    with path.open("wb") as stream:
        for part in range(100_000):
            data = _part(session, host, name, part)
            stream.write(data)
            progress.show(f"{host}: {stream.tell() / 1e6:.0f} MB")
            if len(data) < PART_BYTES:
                progress.close()
                return path
    fail(f"{host}: the capsule of {name} does not end")


def _part(session: zenoh.Session, host: str, name: str, part: int) -> bytes:
    selector = zenoh.Selector(f"{host}/blackbox/capsule", zenoh.Parameters({"name": name, "part": str(part)}))
    for reply in session.get(selector, timeout=QUERY_TIMEOUT_S):
        if reply.ok is not None:
            return bytes(reply.ok.payload.to_bytes())
    fail(f"{host}: part {part} of {name} did not come")
