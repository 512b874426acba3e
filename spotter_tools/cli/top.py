"""`spotter top`: everything on the bus in one terminal: verdict, services, rates, ages, latency, CPU, memory."""

from __future__ import annotations

import threading
from typing import Annotated

import msgspec
import typer

from common.codec import to_builtins
from common.topics import spoken
from spotter_tools.cli.connect import DEFAULT_ENDPOINT, AsJson, Connect, Namespace, bus
from spotter_tools.cli.fail import needs_extra
from spotter_tools.cli.fusion_view import FusionView, SensorView
from spotter_tools.cli.render import verdict_text
from spotter_tools.cli.system_view import Observer, Overview, ServiceView, TopicView

FIRST_LOOK_S = 2.2  # two status messages a second apart: a CPU share needs both
SERVICE_COLUMNS = ("service", "state", "rate", "age", "CPU", "memory", "dropped", "bad", "slowest stage", "why")
TOPIC_COLUMNS = ("topic", "rate", "KiB/s", "age")
SENSOR_COLUMNS = ("sensor", "state", "origin", "p50", "p99", "why")


def top(
    once: Annotated[bool, typer.Option("--once", help="Look for two seconds, print, end.")] = False,
    period: Annotated[float, typer.Option(min=0.1, max=60.0, help="Seconds between updates.")] = 0.5,
    connect: Connect = DEFAULT_ENDPOINT,
    namespace: Namespace = "",
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
    lines = [*verdict_lines(overview), *bar_lines(overview), ""]
    lines += _table(SERVICE_COLUMNS, [service_cells(one) for one in overview.services])
    lines += ["", *_table(SENSOR_COLUMNS, sensor_rows(overview))]
    return [*lines, "", *_table(TOPIC_COLUMNS, [topic_cells(one) for one in overview.topics])]


def verdict_lines(overview: Overview) -> list[str]:
    """One line a fusion, two if it is not live; which vehicle's it is where there are several."""
    return [
        f"{_whose(one, overview)}{line}"
        for one in overview.fusions
        for line in verdict_text(one.verdict, one.verdict_silent_s).splitlines()
    ]


def bar_lines(overview: Overview) -> list[str]:
    """The health bar of each fusion."""
    return [
        f"{_whose(one, overview)}{one.colour.upper()}: {one.summary}" if one.colour else one.summary or "no health yet"
        for one in overview.fusions
    ]


def sensor_rows(overview: Overview) -> list[tuple[str, ...]]:
    """The sensors of every fusion."""
    rows = []
    for one in overview.fusions:
        for name, sensor in one.sensors.items():
            first, *rest = sensor_cells(name, sensor)
            rows.append((f"{_whose(one, overview)}{first}", *rest))
    return rows


def _whose(one: FusionView, overview: Overview) -> str:
    return f"{one.name}: " if len(overview.fusions) > 1 else ""


def service_cells(one: ServiceView) -> tuple[str, ...]:
    """One service's row of the table, as text."""
    claimed = f"claimed by {one.instances}; " if one.instances > 1 else ""
    return (
        f"{one.vehicle} {one.host}/{one.service}".strip(),
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
    """One topic's row of the table, as text."""
    stale = "  STALE" if one.stale else ""
    return (one.key, f"{one.rate_hz:.1f} Hz", f"{one.bytes_per_s / 1024:.1f}", f"{one.age_s:.2f} s{stale}")


def sensor_cells(name: str, one: SensorView) -> tuple[str, ...]:
    """One sensor's row of the table, as text."""
    p50, p99 = (_or_dash(value, "{:.0f} ms") for value in (one.latency_p50_ms, one.latency_p99_ms))
    return (spoken(name), one.state, one.source_kind, p50, p99, one.reason)


def _or_dash(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)


def _table(columns: tuple[str, ...], rows: list[tuple[str, ...]]) -> list[str]:
    """Left-aligned columns as wide as their widest cell."""
    cells = [columns, *rows]
    widths = [max(len(row[i]) for row in cells) for i in range(len(columns))]
    return ["  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in cells]


def _live(observer: Observer, period: float) -> None:
    try:
        from spotter_tools.cli.top_app import TopApp
    except ImportError:
        needs_extra("`spotter top --once` needs nothing, the live view needs", "laptop")
    TopApp(observer, period).run()
