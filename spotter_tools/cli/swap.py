"""`spotter swap SERVICE --candidate CMD`: replace a running service without a gap, or say why not."""

from __future__ import annotations

import shlex
import signal
import sys
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from common.topics import service_row
from spotter_tools.cli.connect import DEFAULT_ENDPOINT, Connect, Namespace, bus, namespace_in_use, own_name
from spotter_tools.cli.fail import fail
from spotter_tools.swap.compare import Limits
from spotter_tools.swap.keep import keep
from spotter_tools.swap.order import Order, Outcome
from spotter_tools.swap.run import swap as run_swap


def swap(
    service: Annotated[str, typer.Argument(help="The service to replace, e.g. radar.")],
    candidate: Annotated[str, typer.Option("--candidate", help="Command of the replacement, e.g. 'spotter-radar'.")],
    seconds: Annotated[float, typer.Option(min=1.0, help="How long both are compared.")] = 20.0,
    probation: Annotated[float, typer.Option(min=1.0, help="How long the new one is watched.")] = 5.0,
    min_rate: Annotated[float, typer.Option(help="Least rate, as share of the live one.")] = Limits().rate,
    min_matches: Annotated[float, typer.Option(help="Least share of objects in common.")] = Limits().matches,
    max_weaker: Annotated[float, typer.Option(help="Share of messages with a lower level.")] = Limits().weaker,
    host: Annotated[
        str, typer.Option("--host", callback=own_name, help="Where it runs, if not where the topics table says.")
    ] = "",
    stop: Annotated[
        str, typer.Option("--stop", help="How its supervisor stops the old one, e.g. 'systemctl stop spotter-radar'.")
    ] = "",
    start: Annotated[
        str, typer.Option("--start", help="How its supervisor starts the old one again, to roll back.")
    ] = "",
    leave: Annotated[
        bool, typer.Option("--leave", help="End at once, also when no supervisor watches the new process.")
    ] = False,
    log: Annotated[Path | None, typer.Option("--log", help="The candidate's output; default swap-SERVICE.log.")] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Compare only.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object at the end.")] = False,
    connect: Connect = DEFAULT_ENDPOINT,
    namespace: Namespace = "",
) -> None:
    """Run a candidate in the shadow of a live service, compare, promote it or leave everything as it is."""
    for signum in (signal.SIGTERM, signal.SIGHUP):  # so that the candidate is stopped in these cases too
        signal.signal(signum, signal.default_int_handler)
    try:
        row = service_row(service)
    except KeyError as error:
        fail(str(error.args[0]), code=2)
    for option, command in (("--candidate", candidate), ("--stop", stop or "none"), ("--start", start or "none")):
        _check_command(option, command)
    order = Order(
        service=service,
        host=host or row.host,
        candidate=candidate,
        seconds=seconds,
        probation_s=probation,
        limits=Limits(rate=min_rate, matches=min_matches, weaker=max_weaker),
        connect=connect.split(",")[0],
        namespace=(namespace := namespace_in_use(connect, namespace)),
        stop_command=stop,
        start_command=start,
        log=log or Path(f"swap-{service}.log"),
        dry_run=dry_run,
    )
    with bus(connect, namespace) as session:
        outcome, live = run_swap(session, order, _say)
    print(msgspec.json.encode(outcome).decode() if as_json else "\n".join(_lines(order, outcome)), flush=True)
    kept = 0
    if live is not None and not leave:
        _say(f"supervising process {live.process.pid}: started again when it dies; Ctrl-C stops it")
        kept = keep(service, live, _say)
    raise SystemExit(kept or (0 if outcome.promoted or (dry_run and not outcome.reasons) else 1))


def _check_command(option: str, command: str) -> None:
    """Check before anything is started that the command can be split into words."""
    try:
        words = shlex.split(command)
    except ValueError as error:
        fail(f"{option} {command!r}: expected a command, {str(error).lower()}", code=2)
    if not words:
        fail(f"{option} {command!r}: expected a command, found none", code=2)


def _say(text: str) -> None:
    print(f"  {text}", file=sys.stderr)


def _lines(order: Order, outcome: Outcome) -> list[str]:
    lines = []
    if (c := outcome.comparison) is not None:
        lines += [
            f"rate      live {c.live_hz:.1f} Hz, candidate {c.candidate_hz:.1f} Hz",
            f"latency   live {_ms(c.live_p95_ms)}, candidate {_ms(c.candidate_p95_ms)} (95 %)",
            f"objects   {_share(c.matches)} in common over {c.pairs} pairs of messages",
            f"level     lower in {_share(c.weaker)}, higher in {_share(c.stronger)}",
        ]
    if (h := outcome.switchover) is not None:
        lines += [
            f"switchover {_change(h.change_ms)}; {h.missed} missed (before: {h.missed_before}), {h.lost} lost",
            f"gaps      longest {_ms(h.longest_gap_ms)} (before: {_ms(h.longest_gap_before_ms)}), "
            f"usual {_ms(h.usual_gap_ms)}",
            f"flaps     verdict {h.verdict_flaps} (before: {h.verdict_flaps_before}), "
            f"health {h.health_flaps} (before: {h.health_flaps_before})",
        ]
    if outcome.promoted:
        watched = " (watched by its host's supervisor)" if outcome.supervised else ""
        lines.append(f"promoted: {outcome.new}, process {outcome.pid}{watched}. For the next start put into site.toml:")
        lines.append(f"  [hosts.{order.host}.services.{order.service}]  command = {order.candidate!r}")
    elif not outcome.reasons:
        lines.append("it may take over (nothing was changed)")
    return lines + [f"{'note' if outcome.promoted else 'not promoted'}: {reason}" for reason in outcome.reasons]


def _change(change_ms: float) -> str:
    return f"after {change_ms:.0f} ms" if change_ms >= 0.0 else f"both published for {-change_ms:.0f} ms"


def _ms(value: float | None) -> str:
    return "-" if value is None else f"{value:.0f} ms"


def _share(value: float | None) -> str:
    return "-" if value is None else f"{value:.0%}"
