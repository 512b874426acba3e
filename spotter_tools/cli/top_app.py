"""The screen of `spotter top`, in Textual: a verdict band, the health bar and three tables that keep their scroll."""

from __future__ import annotations

from typing import ClassVar, Protocol

from rich.text import Text
from textual.app import App, ComposeResult
from textual.containers import VerticalScroll
from textual.widgets import DataTable, Footer, Static

from common.messages import LEVELS
from spotter_tools.cli.system_view import Overview
from spotter_tools.cli.top import (
    SENSOR_COLUMNS,
    SERVICE_COLUMNS,
    TOPIC_COLUMNS,
    bar_lines,
    sensor_rows,
    service_cells,
    topic_cells,
    verdict_lines,
)

COLOURS = {
    "online": "green", "starting": "yellow", "degraded": "yellow", "disconnected": "bold red", "?": "dim",
    "recorded": "magenta", "emulated": "magenta", "simulated": "magenta", "unknown": "magenta",
}  # fmt: skip


class Looker(Protocol):
    """A source of the present state: the bus, or a test."""

    def overview(self) -> Overview:
        """Everything as of now."""


class TopApp(App[None]):
    """Asks ``observer`` for an overview every ``period`` seconds and shows it."""

    TITLE = "spotter top"
    BINDINGS: ClassVar = [("q", "quit", "Quit"), ("p", "pause", "Pause")]
    CSS = """
    #verdict { padding: 0 1; text-style: bold; width: 100%; color: white; }
    #health { padding: 0 1; width: 100%; }
    .SAFE { background: #1b5e20; }   .CAUTION { background: #8a5a00; }
    .IMMINENT { background: #a3001b; }   .NONE { background: #444444; }
    DataTable { height: auto; margin-top: 1; }
    """

    def __init__(self, observer: Looker, period: float) -> None:
        super().__init__()
        self._observer = observer
        self._period = period
        self._paused = False

    def compose(self) -> ComposeResult:
        yield Static(id="verdict", markup=False)
        yield Static(id="health", markup=False)
        with VerticalScroll():
            for name in ("services", "sensors", "topics"):
                yield DataTable(id=name, cursor_type="none", zebra_stripes=True)
        yield Footer()

    def on_mount(self) -> None:
        for name, columns in (("services", SERVICE_COLUMNS), ("sensors", SENSOR_COLUMNS), ("topics", TOPIC_COLUMNS)):
            self.query_one(f"#{name}", DataTable).add_columns(*columns)
        self.refresh_view()
        self.set_interval(self._period, self.refresh_view)

    def action_pause(self) -> None:
        self._paused = not self._paused
        self.sub_title = "paused" if self._paused else ""

    def refresh_view(self) -> None:
        """Ask and draw, unless paused."""
        if self._paused:
            return
        overview = self._observer.overview()
        band = self.query_one("#verdict", Static)
        band.update("\n".join(verdict_lines(overview)))
        band.set_classes(_worst(overview))
        self.query_one("#health", Static).update("\n".join(bar_lines(overview)))
        self._fill("services", [service_cells(one) for one in overview.services])
        self._fill("sensors", sensor_rows(overview))
        self._fill("topics", [topic_cells(one) for one in overview.topics])

    def _fill(self, name: str, rows: list[tuple[str, ...]]) -> None:
        table = self.query_one(f"#{name}", DataTable)
        table.clear()
        for first, *rest in rows:
            table.add_row(first, *(Text(cell, style=_style(cell)) for cell in rest))


def _worst(overview: Overview) -> str:
    """The class of the band: NONE as soon as one fusion gives no verdict, else the highest level."""
    levels = [one.verdict.level if one.verdict else None for one in overview.fusions]
    known = [level for level in levels if level is not None]
    return max(known, key=LEVELS.index) if len(known) == len(levels) else "NONE"


def _style(cell: str) -> str:
    return "bold red" if cell.endswith("STALE") else COLOURS.get(cell, "")
