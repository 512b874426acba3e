"""`spotter metrics`: the same figures as `spotter top`, for Prometheus."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from typing import Annotated, Any

import typer

from common.messages import LEVELS
from spotter_tools.cli.connect import DEFAULT_ENDPOINT, Connect, Namespace, bus, one_host
from spotter_tools.cli.fail import fail, needs_extra
from spotter_tools.cli.system_view import Observer, Overview

Rows = Sequence[tuple[tuple[str, ...], float]]  # label values, figure
STATES = ("starting", "online", "degraded", "disconnected")
SENSOR_STATES = ("online", "degraded", "disconnected")


def metrics(
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Where Prometheus asks: http://ADDRESS:PORT/metrics.")
    ] = 9108,
    address: Annotated[
        str, typer.Option(help="0.0.0.0 lets other machines ask; figures only, no control.")
    ] = "127.0.0.1",
    host: Annotated[
        str, typer.Option(callback=one_host, help="Only what this host publishes, e.g. pi0; default: the whole site.")
    ] = "*",
    connect: Connect = DEFAULT_ENDPOINT,
    namespace: Namespace = "",
) -> None:
    """Serve rates, ages, states, counts, latency, CPU, memory and the verdict's level until Ctrl-C."""
    try:
        from prometheus_client import CollectorRegistry, start_http_server
    except ImportError:
        needs_extra("metrics need", "laptop")
    stop = threading.Event()
    for signum in (signal.SIGINT, signal.SIGTERM):
        signal.signal(signum, lambda *_: stop.set())
    with bus(connect, namespace) as session:
        observer, registry = Observer(session, host), CollectorRegistry()
        registry.register(Collector(observer))
        try:
            server, thread = start_http_server(port, address, registry)
        except OSError as error:
            fail(f"--port {port}: cannot listen on {address}: {error.strerror}")
        sys.stderr.write(f"  http://{address}:{server.server_port}/metrics\n")
        stop.wait()
        server.shutdown()
        server.server_close()
        thread.join()
        observer.close()


class Collector:
    """Asked by prometheus_client at every scrape."""

    def __init__(self, observer: Observer) -> None:
        self._observer = observer

    def collect(self) -> Iterator[Any]:
        overview = self._observer.overview()
        yield _vehicles(self._observer.vehicles())
        yield from _services(overview)
        yield from _topics(overview)
        yield from _sensors(overview)
        yield from _verdict(overview)


def _vehicles(vehicles: dict[str, str]) -> Any:
    """To be joined by host: ``... * on(host) group_left(vehicle) spotter_host_vehicle``."""
    rows = [((host, vehicle), 1.0) for host, vehicle in sorted(vehicles.items())]
    return _gauge(
        "spotter_host_vehicle", "The vehicle of a host, where vehicles have names.", ("host", "vehicle"), rows
    )


def _services(overview: Overview) -> Iterator[Any]:
    who = ("host", "service")
    plain = (
        ("up", "Processes with a liveliness token; 2 and more claim the same topics.", "instances"),
        ("rate_hertz", "Publications of the service's main topic per second, by itself.", "rate_hz"),
        ("cpu_share", "CPU time per second, of one core.", "cpu_share"),
        ("last_frame_age_seconds", "Since the last publication of the main topic, by itself.", "last_frame_age_s"),
    )
    for name, help_text, attribute in plain:
        values = [(one, getattr(one, attribute)) for one in overview.services]
        rows = [((one.host, one.service), value) for one, value in values if value is not None]
        yield _gauge(f"spotter_service_{name}", help_text, who, rows)
    memory = [((one.host, one.service), 1e6 * one.rss_mb) for one in overview.services]
    yield _gauge("spotter_service_memory_bytes", "Resident memory.", who, memory)
    states = [
        ((one.host, one.service, state), float(one.state == state)) for one in overview.services for state in STATES
    ]
    yield _gauge("spotter_service_state", "1 for the state it is in.", (*who, "state"), states)
    counters = (
        ("published", "Messages published since the process started.", "published"),
        ("dropped", "Frames skipped because newer ones were there.", "dropped"),
        ("bad_input", "Input that was rejected.", "bad_input"),
        ("cpu_seconds", "CPU time used.", "cpu_s"),
    )
    for name, help_text, attribute in counters:
        rows = [((one.host, one.service), float(getattr(one, attribute))) for one in overview.services]
        yield _counter(f"spotter_service_{name}", help_text, who, rows)


def _topics(overview: Overview) -> Iterator[Any]:
    rates = [((one.key,), one.rate_hz) for one in overview.topics]
    yield _gauge("spotter_topic_rate_hertz", "Messages per second as they arrive here.", ("key",), rates)
    volumes = [((one.key,), one.bytes_per_s) for one in overview.topics]
    yield _gauge("spotter_topic_bytes_per_second", "Payload as it arrives here.", ("key",), volumes)
    ages = [((one.key,), one.age_s) for one in overview.topics]
    yield _gauge("spotter_topic_age_seconds", "Since the last message arrived here.", ("key",), ages)
    limits = [((one.key,), one.age_limit_s) for one in overview.topics if one.age_limit_s is not None]
    yield _gauge("spotter_topic_age_limit_seconds", "Age at which readers call it stale.", ("key",), limits)
    counts = [((one.key,), float(one.messages)) for one in overview.topics]
    yield _counter("spotter_topic_messages", "Messages that arrived here.", ("key",), counts)


def _sensors(overview: Overview) -> Iterator[Any]:
    """``host`` is the fusion's."""
    every = [(one.host, name, sensor) for one in overview.fusions for name, sensor in one.sensors.items()]
    states = [((host, name, state), float(one.state == state)) for host, name, one in every for state in SENSOR_STATES]
    yield _gauge("spotter_sensor_state", "1 for the state fusion says it is in.", ("host", "sensor", "state"), states)
    live = [((host, name), float(one.source_kind == "live")) for host, name, one in every]
    yield _gauge("spotter_sensor_live", "1: its data are measured, not recorded or made up.", ("host", "sensor"), live)
    latencies = [
        ((host, name, quantile), ms / 1e3)
        for host, name, one in every
        for quantile, ms in (("0.5", one.latency_p50_ms), ("0.99", one.latency_p99_ms))
        if ms is not None
    ]
    help_text = "Measurement to the first verdict that used it, over the last minute."
    yield _gauge("spotter_latency_seconds", help_text, ("host", "sensor", "quantile"), latencies)


def _verdict(overview: Overview) -> Iterator[Any]:
    """By the fusion's host, which is empty if none was found."""
    fusions = [((one.host,), one) for one in overview.fusions]
    levels = [(host, -1.0 if one.verdict is None else float(LEVELS.index(one.verdict.level))) for host, one in fusions]
    help_text = "0 SAFE, 1 CAUTION, 2 IMMINENT, -1 none: treat as STOP."
    yield _gauge("spotter_verdict_level", help_text, ("host",), levels)
    blind = [(host, float(one.verdict is None or one.verdict.blind)) for host, one in fusions]
    yield _gauge("spotter_verdict_blind", "1 when nothing can see, or there is no verdict.", ("host",), blind)
    silent = [(host, one.verdict_silent_s) for host, one in fusions]
    yield _gauge("spotter_verdict_age_seconds", "Since the newest verdict arrived here.", ("host",), silent)


def _gauge(name: str, help_text: str, labels: tuple[str, ...], rows: Rows) -> Any:
    from prometheus_client.core import GaugeMetricFamily

    family = GaugeMetricFamily(name, help_text, labels=labels)
    for values, value in rows:
        family.add_metric(values, value)
    return family


def _counter(name: str, help_text: str, labels: tuple[str, ...], rows: Rows) -> Any:
    from prometheus_client.core import CounterMetricFamily

    family = CounterMetricFamily(name, help_text, labels=labels)
    for values, value in rows:
        family.add_metric(values, value)
    return family
