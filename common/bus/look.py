"""``spotter-<service> look``: open the source as the service would, read for a second, print what comes. No bus.

A service provides a generator that opens its own source: ``looks(config, seconds)``. ``collect`` runs a source that
waits for its device in a thread and yields the items of each period.
"""

from __future__ import annotations

import logging
import os
import queue
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from typing import Annotated, Generic, NamedTuple, NoReturn, TypeVar

import msgspec
import typer

from common.bus.service_app import load_config
from common.bus.status import Report
from common.clock import monotonic_s
from common.config import ConfigError, ServiceConfig
from common.messages import ServiceStatus
from common.source_url import source_kind

C = TypeVar("C", bound=ServiceConfig)
T = TypeVar("T")

PATIENCE_S = 20.0  # for the first item, for example while a camera opens; a lost device is reported earlier
LOST_S = 1.5  # stop waiting for a source that reports a lost device for this long
POLL_S = 0.1


class Look(msgspec.Struct, frozen=True, kw_only=True):
    """The result for one period."""

    sees: bool  # data came, and they are plausible
    what: str  # figures for the user
    do: str = ""  # advice if ``sees`` is false


class PeriodSamples(NamedTuple, Generic[T]):
    """The items of a source in one period, their rate, and the source\'s status at its end."""

    items: list[T]
    rate_hz: float
    status: ServiceStatus

    def nothing(self, of: str) -> Look:
        """The result for a period without items; ``of`` names the missing item."""
        why = self.status.reason
        if why in ("", "starting"):
            why = f"no {of} came, and no error either"
        return Look(
            sees=False, what=why, do="power, wiring, `source`? docs/bring-up.md shows what each fault looks like"
        )


class _End(NamedTuple):
    error: BaseException | None


def collect(
    open_items: Callable[[Report], Iterable[T]], seconds: float, patience_s: float = PATIENCE_S
) -> Iterator[PeriodSamples[T]]:
    """One ``PeriodSamples`` after each period, until the source ends; the first period begins with the first item.

    Raises:
        Exception: an error of the source; ConfigError, OSError or ValueError for the expected ones.
    """
    report, arrived = Report("look"), queue.Queue[tuple[float, T | _End]]()

    def read() -> None:
        error: BaseException | None = None
        try:
            for item in open_items(report):
                arrived.put((monotonic_s(), item))
        except Exception as raised:  # noqa: BLE001  raised again in the thread that reads the items
            error = raised
        arrived.put((monotonic_s(), _End(error)))

    threading.Thread(target=read, name="look", daemon=True).start()
    _await_first(arrived, report, patience_s)
    times_s: list[float] = []
    while True:
        items: list[T] = []
        times_s, until_s, ended = times_s[-1:], monotonic_s() + seconds, False
        while not ended and (left_s := until_s - monotonic_s()) > 0:
            try:
                at_s, item = arrived.get(timeout=left_s)
            except queue.Empty:
                break
            if isinstance(item, _End):
                if item.error is not None:
                    raise item.error
                ended = True
            else:
                items.append(item)
                times_s.append(at_s)
        yield PeriodSamples(items, _rate_hz(times_s), report.snapshot())
        if ended:
            return


def _await_first(arrived: queue.Queue[tuple[float, T | _End]], report: Report, patience_s: float) -> None:
    """Wait for the first item, without taking it, or until the time is over or the device is lost."""
    until_s, lost_s = monotonic_s() + patience_s, 0.0
    while arrived.empty() and monotonic_s() < until_s and lost_s < LOST_S:
        report.changed.wait(POLL_S)
        report.changed.clear()
        lost_s = lost_s + POLL_S if report.snapshot().state == "disconnected" else 0.0


def _rate_hz(times_s: list[float]) -> float:
    """Mean rate of these times, which may include the last one of the period before."""
    return (len(times_s) - 1) / max(times_s[-1] - times_s[0], 1e-3) if len(times_s) > 1 else 0.0


def add_look(app: typer.Typer, config_type: type[C], looks: Callable[[C, float], Iterator[Look]]) -> None:
    """Add the subcommand ``look`` to the command line of a service."""

    @app.command()
    def look(context: typer.Context, seconds: Seconds = 1.0, watch: Watch = False, as_json: AsJson = False) -> None:
        """Open the source, read it, print what the sensor measures. Exit code 1 when there is nothing."""
        config = load_config(config_type, *context.obj)
        show(config, looks(config, seconds), watch, as_json)


Seconds = Annotated[float, typer.Option(min=0.1, max=60.0, help="How long to read the source.")]
Watch = Annotated[bool, typer.Option("--watch", "-w", help="Go on until Ctrl-C: the bring-up screen.")]
AsJson = Annotated[bool, typer.Option("--json", help="One JSON object a look.")]


def show(config: ServiceConfig, looks: Iterator[Look], watch: bool, as_json: bool) -> NoReturn:
    """Write each look as a line, only the first without ``watch``, and end the process."""
    logging.getLogger().addHandler(logging.NullHandler())  # the line printed below contains the error
    seen = False
    try:
        for one in looks:
            seen = one.sees
            sys.stdout.write((msgspec.json.encode(one).decode() if as_json else line_of(config, one)) + "\n")
            sys.stdout.flush()
            if not watch:
                break
    except ConfigError as error:
        sys.stderr.write(f"spotter: {error}\n")
        _end(2)
    except (OSError, ValueError) as error:
        sys.stderr.write(f"spotter: {config.source}: {error}\n")
        _end(1)
    except KeyboardInterrupt:
        _end(0 if seen else 1)
    _end(0 if seen else 1)


def line_of(config: ServiceConfig, look: Look) -> str:
    """One line, and a second one with what to do."""
    kind = source_kind(config.source)
    origin = "" if kind == "live" else f" [{kind.upper()}]"
    what = look.what.removeprefix(f"{config.source}: ")
    then = f"\n        -> {look.do}" if look.do else ""
    return f"{'sees   ' if look.sees else 'NOTHING'} {config.source}{origin}: {what}{then}"


def _end(code: int) -> NoReturn:
    """Exit at once: the thread that waits for a device needs no cleanup."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)
