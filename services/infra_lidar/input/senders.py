"""For ``spotter-infra-lidar look FILE_OR_PORT``: which lidars send there, and what to write to read them."""

from __future__ import annotations

import socket
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from common.clock import monotonic_s, utc_ns
from common.config import ConfigError
from common.source_url import SourceUrl, port_in
from services.infra_lidar.input.calibration_files import beside, captured_metadata
from services.infra_lidar.input.captures import CaptureError, Datagram, read_capture
from services.infra_lidar.input.look_recordings import describe_recording, is_recording
from services.infra_lidar.input.models import KINDS, kind_of
from services.infra_lidar.input.sensors import VLS128, Sender, model_of, returns_of
from services.infra_lidar.input.spinning import PacketParser

NOTES = {  # where a calibration comes from that a capture lacks
    "hesai": "that file, the sensor's own angle correction, is saved by its web page or PandarView",
    "robosense": "that file has 128 lines of vertical and horizontal degrees; or record the DIFOP port too",
}
NOTES_LIVE = {
    "hesai": "the service asks the sensor for its calibration; without an answer give ?calibration=FILE",
    "robosense": "the service waits for the beam angles on the sensor's DIFOP port, 7788 or &difop=PORT",
}
MAX_KEPT = 20_000  # packets of each sensor that are looked at: some seconds


def print_senders(where: str, seconds: float) -> bool:
    """Write which lidars send in a capture or to a UDP port, or what a bag or files hold. False: nothing readable.

    Raises:
        ConfigError: a file that cannot be read, or a port that is taken or out of range.
    """
    text = where.lstrip(":")
    port = port_in(text, "UDP port") if text.isdecimal() else None
    if port is None and is_recording(Path(where)):
        lines = list(describe_recording(Path(where)))
        sys.stdout.writelines(f"{line}\n" for line, _ in lines)
        return any(readable for _, readable in lines)
    datagrams = list(_kept(Path(where)) if port is None else listen(port, seconds))
    for line in describe(datagrams, Path(where) if port is None else None):
        sys.stdout.write(line + "\n")
    return any(model_of(datagram.payload) for datagram in datagrams)


def listen(port: int, seconds: float) -> Iterator[Datagram]:
    """What arrives on a UDP port for some seconds.

    Raises:
        ConfigError: the port is taken.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        try:
            receiver.bind(("", port))
        except OSError as error:
            raise ConfigError(f"cannot listen on UDP port {port}: {error}; is the service running?") from None
        until_s = monotonic_s() + seconds
        while (left_s := until_s - monotonic_s()) > 0.0:
            receiver.settimeout(left_s)
            try:
                payload, (address, *_) = receiver.recvfrom(65536)
            except TimeoutError:
                return
            yield Datagram(utc_ns(), address, port, payload)


def _kept(path: Path) -> Iterator[Datagram]:
    counts: dict[tuple[str, int, int], int] = defaultdict(int)
    try:
        with path.open("rb") as stream:
            for datagram in read_capture(stream):
                key = datagram.sender, datagram.port, len(datagram.payload)
                counts[key] += 1
                if counts[key] <= MAX_KEPT:
                    yield datagram
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from None
    except CaptureError as error:
        raise ConfigError(f"{path}: {error}") from None


def describe(datagrams: list[Datagram], path: Path | None) -> Iterator[str]:
    """Lines for a person, one sensor after the other. ``path`` is the capture's, None for a port."""
    by_sender: dict[Sender, list[Datagram]] = defaultdict(list)
    for datagram in datagrams:
        by_sender[Sender(datagram.sender, datagram.port, model_of(datagram.payload))].append(datagram)
    lidars = {sender: sent for sender, sent in by_sender.items() if sender.model}
    if not lidars:
        yield "no packets of a lidar that we know" + (f" among {len(datagrams)} datagrams" if datagrams else "")
    for sender, sent in lidars.items():
        span_s = (sent[-1].stamp_ns - sent[0].stamp_ns) * 1e-9
        returns = returns_of(sent[0].payload)
        rate = f"{len(sent) / span_s:.0f} packets a second" if span_s > 0.0 else f"{len(sent)} packets"
        line = f"{sender}: {rate} of {len(sent[0].payload)} bytes"
        yield f"{line}, {returns}" if returns else line
        if span_s <= 0.0 and len(sent) > 1:
            yield "    the last stamp is not after the first: the stamps do not tell a rate"
        if sender.supported:
            yield from _details(sender, sent, path, span_s)


def _details(sender: Sender, sent: list[Datagram], path: Path | None, span_s: float) -> Iterator[str]:
    try:
        parser, missing, note = _parser(sender, path)
    except ConfigError as error:
        yield f"    {error}"
        return
    ended = parser.feed_all([packet.payload for packet in sent], [packet.stamp_ns for packet in sent])
    if ended:
        returns = sum(one.range_image.returns for one in ended) // len(ended)
        lost = sum(one.quality.packets_lost for one in ended)
        counters = parser.order.counters
        rate = f"{len(ended) / span_s:.1f} revolutions per second" if span_s > 0.0 else f"{len(ended)} revolutions"
        yield (
            f"    {rate}, {returns} returns per revolution; "
            f"packets lost {lost}, doubled {counters['packet doubled']}, late {counters['packet late']}"
        )
        others = sorted(counters.keys() - {"packet doubled", "packet late"})
        yield from (f"    {name}: {counters[name]}" for name in others)
    yield f'    source = "{source_of(sender, path)}{missing}"'
    if note:
        yield f"    {note}"


def _parser(sender: Sender, path: Path | None) -> tuple[PacketParser, str, str]:
    """A parser for counting, what has to be added to the source for measuring, and a note on where that comes from."""
    kind = KINDS[kind_of(sender.model)]
    if path is None:
        if kind is KINDS["ouster"]:
            raise ConfigError("its metadata are asked of the sensor when the service starts")
        return kind.parser(kind.to_count, 0.0), "", NOTES_LIVE.get(kind_of(sender.model), "")
    try:
        return kind.parser(captured_metadata(sender, path, SourceUrl("file", str(path), {})), 0.0), "", ""
    except ConfigError as error:
        if not kind.to_count:
            raise
        note = str(error) if beside(path, ".csv").exists() else NOTES[kind_of(sender.model)]
        return kind.parser(kind.to_count, 0.0), "&calibration=ANGLES.csv", note


def source_of(sender: Sender, path: Path | None) -> str:
    """The `source` that reads this sensor."""
    if path is not None:
        return f"file:{path}?from={sender.address}&port={sender.port}"
    if sender.model == VLS128:
        return f"velodyne://:{sender.port}?from={sender.address}"
    return f"{kind_of(sender.model)}://{sender.address}?port={sender.port}"
