"""`spotter ls | info | health`: look at what is on the bus."""

from __future__ import annotations

import contextlib
import difflib
import queue
import sys
import time
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
import typer
import zenoh

from common import topics
from common.bus.published import why_silent
from common.bus.vehicles import vehicles_on_bus
from common.codec import DecodeError, decode, to_builtins
from common.messages import Message, RouterLinks, ServiceInfo, ServiceStatus, SystemHealth, Verdict
from spotter_tools.cli.connect import DEFAULT_ENDPOINT, AsJson, Connect, Namespace, bus, one_host
from spotter_tools.cli.fail import fail, needs_extra
from spotter_tools.cli.render import coloured, health_lines, readable, reason_lines, verdict_text
from spotter_tools.cli.selection import key_expression
from spotter_tools.wording import without_numbers

M = TypeVar("M", bound=Message)
QUERY_TIMEOUT_S = 1.0
NO_VERDICT_AFTER_S = topics.FUSION_VERDICT.age_limit_s or 0.25


def ls(connect: Connect = DEFAULT_ENDPOINT, namespace: Namespace = "", as_json: AsJson = False) -> None:
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
        vehicles = vehicles_on_bus(session) if rows else {}
    rows = [{**row, "vehicle": vehicles.get(row["host"], "")} for row in rows]
    if as_json:
        for row in rows:
            print(msgspec.json.encode(row).decode())
        return
    if not rows:
        print("no service is alive: no liveliness token on this router")
    for row in sorted(rows, key=lambda row: row["vehicle"]):
        state = coloured(row["state"]) + (f" ({row['reason']})" if row["reason"] else "")
        kind = coloured(row["source_kind"] if row["source"] else "-", 10)
        vehicle = f"{row['vehicle']:<9} " if vehicles else ""
        who = f"{vehicle}{row['host'] + '/' + row['service']:<24}"
        print(f"{who} {row['instance']:<9} {row['version']:<8} {kind} {state}")


def info(
    service: Annotated[
        str, typer.Argument(help="HOST/SERVICE as `spotter ls` prints it, SERVICE on any host, or a recording's file.")
    ],
    connect: Connect = DEFAULT_ENDPOINT,
    namespace: Namespace = "",
    as_json: AsJson = False,
) -> None:
    """What a service says of itself: version, configuration, topics, process; or what a recording holds.

    Exit code 1 when the service does not answer, or the file cannot be read or ends too early.
    """
    if service.endswith(".mcap"):
        _show_recording(Path(service), as_json)
        return
    key_expression(service)
    key = f"{service if '/' in service else '*/' + service}/info"
    with bus(connect, namespace) as session:
        answers = _answers(session, key, ServiceInfo)
        if not answers:
            fail(_who_answers(session, service))
    for at, answer in answers:
        content = to_builtins(answer)
        if as_json:
            print(msgspec.json.encode({"key": at, "message": content}, enc_hook=repr).decode())
        else:
            print(f"{at.removesuffix('/info')}\n{readable(content)}")


def _show_recording(path: Path, as_json: bool) -> None:
    if not path.exists():
        fail(f"{path}: no such file", code=2)
    try:
        from common.recording.reader import RecordingError
        from spotter_tools.cli.recording_info import describe
    except ImportError:
        needs_extra("reading a recording needs", "laptop")
    try:
        found = describe(path)
    except RecordingError as error:
        fail(str(error))
    print(msgspec.json.encode(found).decode() if as_json else readable(found, 0))
    if not found["complete"]:
        fail(f"{path}: cut off before its end; above is what is there")


def _who_answers(session: zenoh.Session, asked: str) -> str:
    """One sentence for a service that does not answer: the nearest name of those that are there."""
    replies = session.liveliness().get(topics.ANY_TOKEN, timeout=QUERY_TIMEOUT_S)
    tokens = {topics.parse_token(str(reply.ok.key_expr))[:2] for reply in replies if reply.ok is not None}
    there = sorted(f"{host}/{service}" if "/" in asked else service for host, service in tokens)
    elsewhere = [name for name in there if "/" in asked and name.endswith(f"/{asked.partition('/')[2]}")]
    near = elsewhere or difflib.get_close_matches(asked, there, n=1)
    if not there:
        return f"{asked} does not answer: no service is alive on this router"
    return f"{asked} does not answer; " + (f"did you mean {near[0]}?" if near else f"alive: {', '.join(there)}")


def _answers(session: zenoh.Session, key: str, message_type: type[M]) -> list[tuple[str, M]]:
    """Every sensible answer with its key."""
    found = []
    for reply in session.get(key, timeout=QUERY_TIMEOUT_S, consolidation=zenoh.ConsolidationMode.NONE):
        if reply.ok is not None:
            with contextlib.suppress(DecodeError):
                found.append((str(reply.ok.key_expr), decode(reply.ok.payload.to_bytes(), message_type)))
    return found


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
        "source_kind": info.source_kind if info else "unknown",
        "source": info.source if info else "",
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


def health(
    watch: Annotated[bool, typer.Option("--watch", "-w", help="Go on, a block on every change.")] = False,
    fusion_host: Annotated[
        str, typer.Option(callback=one_host, help="Whose verdict, where there are several vehicles.")
    ] = "*",
    connect: Connect = DEFAULT_ENDPOINT,
    namespace: Namespace = "",
    as_json: AsJson = False,
) -> None:
    """Verdict with its reason, and every sensor's state. Exit code 1 when there is no verdict."""
    inbox: queue.Queue[tuple[str, bytes]] = queue.Queue(maxsize=1000)
    with bus(connect, namespace) as session:
        subscribers = [
            session.declare_subscriber(topic.key(fusion_host), lambda sample: _offer(inbox, sample))
            for topic in (topics.FUSION_VERDICT, topics.FUSION_HEALTH)
        ]
        seen = _watch_health(inbox, watch, as_json)
        if not seen:
            _report_links(session)
            silent = why_silent(session, topics.FUSION_VERDICT.key(fusion_host))
            sys.stderr.write(f"spotter: {silent}\n" if silent else "")
        for subscriber in subscribers:
            subscriber.undeclare()
    if not seen:
        raise SystemExit(1)


def _report_links(session: zenoh.Session) -> None:
    """Why there may be no verdict: what the router here says of the hosts that it cannot link."""
    for key, links in _answers(session, topics.links_key("*"), RouterLinks):
        for host, fault in links.faults.items():
            sys.stderr.write(f"spotter: {key.partition('/')[0]} has no link to {host}: {fault.why}\n")


def _offer(inbox: queue.Queue[tuple[str, bytes]], sample: zenoh.Sample) -> None:
    try:
        inbox.put_nowait((str(sample.key_expr), sample.payload.to_bytes()))
    except queue.Full:
        return  # the terminal is stuck; newer ones will come


class _Received:
    """The newest verdict and health of one fusion: the first from which a message comes.

    Undecodable messages and the fusion of another vehicle are reported once.
    """

    def __init__(self) -> None:
        self.verdict: Verdict | None = None
        self.system: SystemHealth | None = None
        self.verdict_s = time.monotonic()
        self._reported: set[str] = set()
        self._host = ""

    def take(self, key: str, payload: bytes) -> None:
        """Process a message; the fusion of another vehicle is reported once."""
        host = key.partition("/")[0]
        self._host = self._host or host
        if host != self._host:
            self._report(host, f"{host} gives verdicts too; shown is {self._host}, --fusion-host chooses another")
            return
        try:
            if key.endswith("/verdict"):
                self.verdict, self.verdict_s = decode(payload, Verdict), time.monotonic()
            else:
                self.system = decode(payload, SystemHealth)
        except DecodeError as error:
            self._report(key, f"{key} cannot be read: {error}")

    def _report(self, what: str, text: str) -> None:
        if what not in self._reported:
            self._reported.add(what)
            sys.stderr.write(f"spotter: {text}\n")

    def silent_s(self) -> float:
        """Time since the newest verdict, which is dropped when it is too old."""
        silent_s = time.monotonic() - self.verdict_s
        if silent_s > NO_VERDICT_AFTER_S:
            self.verdict = None
        return silent_s


def _watch_health(inbox: queue.Queue[tuple[str, bytes]], watch: bool, as_json: bool) -> bool:
    """Print blocks as they change; returns whether a verdict was seen last."""
    received, shown = _Received(), ""
    first_deadline_s = time.monotonic() + 2.0
    while True:
        with contextlib.suppress(queue.Empty):
            received.take(*inbox.get(timeout=0.05))
        silent_s = received.silent_s()
        waiting = (received.verdict is None or received.system is None) and time.monotonic() < first_deadline_s
        if waiting:
            continue
        block = _block(received.verdict, received.system, silent_s, as_json)
        if without_numbers(block) != shown:  # ages and rates always change
            shown = without_numbers(block)
            print(block, flush=True)
        if not watch:
            return received.verdict is not None


def _block(verdict: Verdict | None, system: SystemHealth | None, silent_s: float, as_json: bool) -> str:
    if as_json:
        row = {
            "verdict": to_builtins(verdict) if verdict else None,
            "health": to_builtins(system) if system and verdict else None,
        }
        return msgspec.json.encode(row).decode()
    lines = [verdict_text(verdict, silent_s), *(reason_lines(verdict) if verdict else [])]
    lines += health_lines(system) if system and verdict else ["health unknown: fusion does not publish"]
    return "\n".join(lines)
