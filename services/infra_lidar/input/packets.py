"""Frames, and captures of packets as a source of them. Opens files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import TypeAlias

import numpy as np

from common.bus.status import Report
from common.config import ConfigError
from common.source_url import SourceUrl
from services.infra_lidar.input.calibration_files import beside, captured_metadata
from services.infra_lidar.input.captures import CaptureError, Datagram, read_capture
from services.infra_lidar.input.models import KINDS, kind_of
from services.infra_lidar.input.ouster import OusterFormat, OusterParser
from services.infra_lidar.input.range_image import Returns, points_of
from services.infra_lidar.input.revolution import Revolution
from services.infra_lidar.input.sensors import OUSTER, SUPPORTED, SURVEY_PACKETS, Sender, model_of, survey
from services.infra_lidar.input.spinning import PacketParser
from services.infra_lidar.sensor_health import FrameQuality

MAX_NAMED = 5  # senders of a capture
READ_AT_ONCE = 64  # packets of a capture


@dataclass(frozen=True)
class Frame:
    """returns: of one revolution. received_ns: UTC ns at which it was complete."""

    returns: Returns
    received_ns: int
    quality: FrameQuality = field(default_factory=FrameQuality)
    packets: list[bytes] = field(default_factory=list)  # what it was decoded from, if it came in packets
    metadata: str = ""  # of the sensor, what they need to be decoded again
    kind: str = "velodyne"  # of the sensor, as in ``models.KINDS``

    @property
    def points(self) -> np.ndarray:
        """(N, 3..5) float32 metres, sensor frame (x, y, z, intensity, ring)."""
        return points_of(self.returns)


Recorded: TypeAlias = tuple[float | None, Frame]
"""A frame of a recording, with the UTC seconds of its measurement if they were recorded."""


def recorded_revolutions(path: Path, url: SourceUrl, report: Report) -> Callable[[], Iterator[Recorded]]:
    """Revolutions of a capture of any sensor of ``models.KINDS``.

    Raises:
        ConfigError: another kind of file, unreadable, of a sensor that is not supported, of several sensors, or without
            the metadata or calibration that this sensor needs.
    """
    try:
        sender = choose_sender(path, url)
    except CaptureError as error:
        raise ConfigError(f"source {url}: {error}") from None
    kind, cut_deg = kind_of(sender.model), url.number("cut", 0.0)
    metadata = captured_metadata(sender, path, url)
    if kind == "ouster":
        layout = OusterFormat(metadata)
        _expect_packets(layout, path, sender, url)
        return lambda: decoded(_packets_of(path, sender, layout.packet_bytes), OusterParser(layout), report)
    return lambda: decoded(_packets_of(path, sender), KINDS[kind].parser(metadata, cut_deg), report)


def choose_sender(path: Path, url: SourceUrl) -> Sender:
    """The one sensor of a capture, or the one that ``?from=`` and ``?port=`` name.

    Raises:
        CaptureError: no capture, or a link layer that is not known.
        ConfigError: no sensor, none that is supported, several, or none of those that were asked for.
    """
    senders: set[tuple[str, int]] = set()
    with path.open("rb") as stream:
        found = list(survey(_noted(islice(read_capture(stream), SURVEY_PACKETS), senders)))
    address, port = url.params.get("from", ""), url.port("port", 0)
    _expect_asked(url, {name for name in senders if address in ("", name[0]) and port in (0, name[1])}, senders)
    asked = [s for s in found if address in ("", s.address) and port in (0, s.port)]
    supported = [sender for sender in asked if sender.supported]
    if len(supported) == 1:
        return supported[0]
    if supported:
        raise ConfigError(
            f"source {url}: several sensors: {'; '.join(map(str, supported))}. Choose one with ?from=ADDRESS or ?port="
        )
    if "metadata" in url.params or beside(path, ".json").exists():
        return Sender(address, port, OUSTER)  # of a kind that is not in the table: the metadata tell its packets
    seen = "; ".join(map(str, asked)) or "no packets of a lidar that we know"
    if found and not asked:
        seen += f" of {_asked_for(url)}; in the capture: {'; '.join(map(str, found))}"
    raise ConfigError(f"source {url}: {seen}. Supported: {', '.join(SUPPORTED)}")


def _noted(datagrams: Iterable[Datagram], senders: set[tuple[str, int]]) -> Iterator[Datagram]:
    """The same; their senders' addresses and ports are added to ``senders``."""
    for datagram in datagrams:
        senders.add((datagram.sender, datagram.port))
        yield datagram


def _asked_for(url: SourceUrl) -> str:
    return ", ".join(f"{name}={url.params[name]}" for name in ("from", "port") if name in url.params)


def _expect_asked(url: SourceUrl, asked: set[tuple[str, int]], senders: set[tuple[str, int]]) -> None:
    """Refuse an address and a port that nothing in the capture has."""
    if senders and not asked:
        there = "; ".join(f"{address}, port {port}" for address, port in sorted(senders)[:MAX_NAMED])
        raise ConfigError(f"source {url}: no packets of {_asked_for(url)}; in the capture: {there}")


def _packets_of(path: Path, sender: Sender, size: int = 0) -> Iterator[tuple[int, bytes]]:
    """(UTC ns, packet) of one sensor, read as they are taken; those of one ``size``, or else of the sensor's model."""
    with path.open("rb") as stream:
        for datagram in read_capture(stream):
            here = sender.address in ("", datagram.sender) and sender.port in (0, datagram.port)
            payload = datagram.payload
            if here and (len(payload) == size if size else model_of(payload) == sender.model):
                yield datagram.stamp_ns, datagram.payload


def _expect_packets(layout: OusterFormat, path: Path, sender: Sender, url: SourceUrl) -> None:
    """Refuse metadata of another mode of the sensor than the capture's."""
    with path.open("rb") as stream:
        sizes = Counter(len(d.payload) for d in islice(read_capture(stream), SURVEY_PACKETS))
    if layout.packet_bytes not in sizes:
        seen = ", ".join(f"{count} of {size}" for size, count in sizes.most_common(3)) or "none"
        raise ConfigError(
            f"source {url}: the metadata ({layout.profile_name}, {layout.beams} beams) say packets of "
            f"{layout.packet_bytes} bytes, the capture has {seen} bytes ({sender.model}): metadata of another mode?"
        )


def decoded(packets: Iterator[tuple[int, bytes]], parser: PacketParser, report: Report) -> Iterator[Recorded]:
    """The revolutions of (UTC ns, packet); what is lost, doubled, late or foreign is counted."""
    counts = ParserCounts(report)
    while some := list(islice(packets, READ_AT_ONCE)):
        stamps_ns, payloads = zip(*some, strict=True)
        revolutions = parser.feed_all(payloads, stamps_ns)
        counts.update(parser)
        for revolution in revolutions:
            count_losses(revolution.quality, report)
            yield revolution.stamp_ns / 1e9, frame_of(revolution)
    if isinstance(parser, OusterParser):  # its last revolution has no packet after it
        last = parser.flush()
        if last is not None:
            yield last.stamp_ns / 1e9, frame_of(last)


def frame_of(revolution: Revolution) -> Frame:
    """The frame of a revolution, received when its last packet came."""
    r = revolution
    return Frame(r.range_image, r.stamp_ns, r.quality, r.packets, r.metadata, r.kind)


def count_losses(quality: FrameQuality, report: Report) -> None:
    """Add what is missing of a revolution to the counters of the service."""
    report.bad_input("packet lost", quality.packets_lost)
    report.bad_input("incomplete revolution", int(not quality.complete))


class ParserCounts:
    """Adds to the counters of a service what a parser has counted. ``update`` it after each packet, it is cheap."""

    def __init__(self, report: Report) -> None:
        self._report = report
        self._reported: Counter[str] = Counter()
        self._total = 0

    def update(self, parser: PacketParser) -> None:
        """What has come since the last time: packets of another kind, doubled, late and damaged ones, faults."""
        total = parser.rejected + parser.order.counters.total()
        if total == self._total:
            return
        now = Counter({"packet of another kind": parser.rejected}) + parser.order.counters
        for name, count in (now - self._reported).items():
            self._report.bad_input(name, count)
        self._reported, self._total = now, total
