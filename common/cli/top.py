"""`spotter top`: everything on the bus in one terminal: verdict, services, rates, ages, latency, CPU, memory."""

from __future__ import annotations

import threading
from typing import Annotated

import msgspec
import typer

from common.cli.connect import DEFAULT_ENDPOINT, AsJson, Connect, Namespace, bus
from common.cli.fail import fail
from common.cli.overview import Observer, Overview, SensorView, ServiceView, TopicView
from common.cli.render import verdict_line
from common.codec import to_builtins

FIRST_LOOK_S = 2.2  # two status messages a second apart: less tells no CPU share
SERVICE_COLUMNS = ("service", "state", "rate", "age", "CPU", "memory", "dropped", "bad", "slowest stage", "why")
TOPIC_COLUMNS = ("topic", "rate", "KiB/s", "age")
SENSOR_COLUMNS = ("sensor", "state", "p50", "p99", "why")


def top(
    once: Annotated[bool, typer.Option("--once", help="Look for two seconds, print, end.")] = False,
    period: Annotated[float, typer.Option(min=0.1, max=60.0, help="Seconds between updates.")] = 0.5,
    connect: Connect = DEFAULT_ENDPOINT,
    namespace: Namespace = "spotter",
    as_json: AsJson = False,
) -> None:
    """Live view of the whole system; q quits. With --json a line per update."""
    with bus(connect, namespace) as session:
        observer = Observer(session)
        try:
            if once or as_json:
                _print(observer, once, period, as_json)
            else:
                _live(observer, period)
        finally:
            observer.close()


def _print(observer: Observer, once: bool, period: float, as_json: bool) -> None:
    pause = threading.Event()
    pause.wait(FIRST_LOOK_S)
    while True:
        overview = observer.overview()
        print(as_line(overview) if as_json else "\n".join(as_text(overview)), flush=True)
        if once:
            return
        pause.wait(period)


def as_line(overview: Overview) -> str:
    """One JSON object."""
    return msgspec.json.encode(to_builtins(overview)).decode()


def as_text(overview: Overview) -> list[str]:
    """The view as plain lines."""
    lines = [verdict_line(overview.verdict, overview.verdict_silent_s), bar(overview), ""]
    lines += _table(SERVICE_COLUMNS, [service_cells(one) for one in overview.services])
    lines += ["", *_table(SENSOR_COLUMNS, [sensor_cells(name, one) for name, one in overview.sensors.items()])]
    return [*lines, "", *_table(TOPIC_COLUMNS, [topic_cells(one) for one in overview.topics])]


def bar(overview: Overview) -> str:
    return f"{overview.colour.upper()}: {overview.summary}" if overview.colour else "no health yet"


def service_cells(one: ServiceView) -> tuple[str, ...]:
    claimed = f"claimed by {one.instances}; " if one.instances > 1 else ""
    return (
        f"{one.host}/{one.service}",
        one.state or "?",
        f"{one.rate_hz:.1f} Hz",
        _or_dash(one.last_frame_age_s, "{:.2f} s"),
        _or_dash(one.cpu_share, "{:.0%}"),
        f"{one.rss_mb:.0f} MB",
        str(one.dropped),
        str(one.bad_input),
        _or_dash(one.slowest_stage_ms, one.slowest_stage + " {:.1f} ms"),
        claimed + one.reason,
    )


def topic_cells(one: TopicView) -> tuple[str, ...]:
    stale = "  STALE" if one.stale else ""
    return (one.key, f"{one.rate_hz:.1f} Hz", f"{one.bytes_per_s / 1024:.1f}", f"{one.age_s:.2f} s{stale}")


def sensor_cells(name: str, one: SensorView) -> tuple[str, ...]:
    p50, p99 = (_or_dash(value, "{:.0f} ms") for value in (one.latency_p50_ms, one.latency_p99_ms))
    return (name, one.state, p50, p99, one.reason)


def _or_dash(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)


def _table(columns: tuple[str, ...], rows: list[tuple[str, ...]]) -> list[str]:
    """Left-aligned columns as wide as their widest cell."""
    cells = [columns, *rows]
    widths = [max(len(row[i]) for row in cells) for i in range(len(columns))]
    return ["  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in cells]


def _live(observer: Observer, period: float) -> None:
    try:
        from common.cli.top_app import TopApp
    except ImportError as error:
        fail(f"the live view needs the extra `laptop`: {error}; `spotter top --once` does not")
    TopApp(observer, period).run()
