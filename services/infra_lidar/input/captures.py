"""Recordings of packets: pcap and pcapng captures. Streams in, datagrams out.

A pcap is read by dpkt, a pcapng by ``pcapng``; from the link layer on it is done here, because captures of lidars come
over VLANs, from ``-i any`` (Linux cooked) and in IP fragments.
"""

from __future__ import annotations

import gzip
import logging
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from ipaddress import ip_address
from typing import BinaryIO, cast

import dpkt

from services.infra_lidar.input.pcapng import MAGIC, PcapngReader, Record

log = logging.getLogger(__name__)

# What dpkt and gzip raise on bytes that are damaged or end too early.
_DAMAGE = (ValueError, dpkt.Error, struct.error, EOFError, OSError, zlib.error)
# Link layers by their number (pcap-linktype(7)): where the EtherType stands, and where the packet begins.
_ETHER_TYPE_AT = {1: (12, 14), 113: (14, 16), 276: (0, 20)}
_BARE_IP_AT = {0: 4, 12: 0, 14: 0, 101: 0, 228: 0, 229: 0}
_VLAN_TYPES = (0x8100, 0x88A8, 0x9100)
_UDP, _IPV6_FRAGMENT = 17, 44
_MAX_FRAGMENTED = 64  # packets that wait for the rest of their fragments
_FRAGMENTS_WAIT_NS = 1_000_000_000


class CaptureError(ValueError):
    """A capture that cannot be read; the text says why."""


@dataclass(frozen=True)
class Datagram:
    """One UDP datagram: UTC ns of its capture, sender's address, destination port, payload."""

    stamp_ns: int
    sender: str
    port: int
    payload: bytes


def read_capture(stream: BinaryIO) -> Iterator[Datagram]:
    """UDP over IPv4 or IPv6 in a pcap or pcapng file, gzipped or not; fragments are joined.

    What follows damaged bytes, or a cut, is left out, and so are packets that cannot be used; the log says so. The
    stream is read as the datagrams are taken, so memory does not grow with it.

    Raises:
        CaptureError: no capture, damaged at its very beginning, or none of its packets can be used.
    """
    name = str(getattr(stream, "name", "capture"))
    try:
        if stream.read(2) == b"\x1f\x8b":
            stream.seek(0)
            stream = cast(BinaryIO, gzip.GzipFile(fileobj=stream))
        stream.seek(0)
        reader = _reader(stream)
    except _DAMAGE as error:
        raise CaptureError(f"no pcap or pcapng capture, or a damaged one ({_words(error)})") from None
    if not isinstance(reader, PcapngReader) and not _is_known(_link(reader)):
        raise CaptureError(f"link layer {_link(reader)} is not known")
    fragments, left_out, used = Fragments(), _LeftOut(), False
    for link, stamp_ns, frame in _records(reader, name):
        if not _is_known(link):
            left_out.links[link] += 1
            continue
        packet = _network_packet(link, frame)
        if _is_cut(packet):
            left_out.cut += 1
            continue
        datagram = _udp(packet, fragments, stamp_ns)
        if datagram is not None:
            used = True
            yield Datagram(stamp_ns, *datagram)
    left_out.unstamped = reader.unstamped if isinstance(reader, PcapngReader) else 0
    if why := str(left_out):
        if not used and not left_out.cut:
            raise CaptureError(why)
        log.warning("%s: left out: %s", name, why)


@dataclass
class _LeftOut:
    """Packets of a capture that cannot be used: by their link layer, with a part only, without a stamp."""

    links: Counter[int] = field(default_factory=Counter)
    cut: int = 0
    unstamped: int = 0

    def __str__(self) -> str:
        reasons = [f"{count} packets: link layer {link} is not known" for link, count in self.links.items()]
        if self.cut:
            reasons.append(
                f"{self.cut} UDP packets are cut, by the capture's snap length (tcpdump -s 0 records whole ones) or at "
                f"the end of the file"
            )
        if self.unstamped:
            reasons.append(
                f"{self.unstamped} packets have no stamp (pcapng simple packet blocks); record them with stamps"
            )
        return "; ".join(reasons)


def _reader(stream: BinaryIO) -> PcapngReader | dpkt.pcap.Reader:
    """For the container that the first bytes tell."""
    magic = stream.read(len(MAGIC))
    stream.seek(0)
    return PcapngReader(stream) if magic == MAGIC else dpkt.pcap.Reader(stream)


def _link(reader: dpkt.pcap.Reader) -> int:
    return int(reader.datalink()) & 0xFFFF  # above are the bits of the frame check sequence


def _is_known(link: int) -> bool:
    return link in _ETHER_TYPE_AT or link in _BARE_IP_AT


def _pcap_records(reader: dpkt.pcap.Reader) -> Iterator[Record]:
    for stamp_s, frame in reader:
        yield Record(_link(reader), round(stamp_s * 1_000_000_000), frame)


def _records(reader: PcapngReader | dpkt.pcap.Reader, name: str) -> Iterator[Record]:
    """What the container holds, up to where it is cut or damaged."""
    count = 0
    try:
        for record in reader if isinstance(reader, PcapngReader) else _pcap_records(reader):
            count += 1
            yield record
    except _DAMAGE as error:
        log.warning("%s: cut or damaged behind packet %d (%s); the rest is left out", name, count, _words(error))


def _words(error: Exception) -> str:
    """What an error says; its type where it says nothing."""
    return str(error) or type(error).__name__


def _network_packet(link: int, frame: bytes) -> bytes:
    """The IP packet in a frame of the link layer, behind any number of VLAN tags; empty if there is none."""
    if link in _BARE_IP_AT:
        return frame[_BARE_IP_AT[link] :]
    type_at, at = _ETHER_TYPE_AT[link]
    ether_type = int.from_bytes(frame[type_at : type_at + 2], "big")
    while ether_type in _VLAN_TYPES:
        ether_type = int.from_bytes(frame[at + 2 : at + 4], "big")
        at += 4
    return frame[at:] if ether_type in (0x0800, 0x86DD) else b""


def _is_cut(packet: bytes) -> bool:
    """Whether the capture holds less of an IP packet of UDP than its header says."""
    version = packet[0] >> 4 if packet else 0
    if version == 4 and len(packet) >= 20:
        return packet[9] == _UDP and int.from_bytes(packet[2:4], "big") > len(packet)
    if version == 6 and len(packet) >= 40:
        return packet[6] in (_UDP, _IPV6_FRAGMENT) and 40 + int.from_bytes(packet[4:6], "big") > len(packet)
    return False


class _Parts:
    """The parts of one IP packet, by their offset. length: of the whole, None until its last part is there."""

    def __init__(self) -> None:
        self.by_offset: dict[int, bytes] = {}
        self.length: int | None = None
        self.newest_ns = 0

    def whole(self) -> bytes | None:
        """All parts joined, once there is no gap between them."""
        at, ordered = 0, sorted(self.by_offset.items())
        for offset, part in ordered:
            if offset != at:
                return None
            at += len(part)
        return b"".join(part for _, part in ordered) if at == self.length else None


class Fragments:
    """IP packets that came in parts, until the last part is there; the oldest are given up when there are too many.

    A sender uses the same identity again after 65536 packets. So parts that wait are forgotten when another packet
    begins with their identity, or when nothing has come for them for ``_FRAGMENTS_WAIT_NS``.
    """

    def __init__(self) -> None:
        self._waiting: dict[tuple[bytes, int], _Parts] = {}

    def add(self, key: tuple[bytes, int], offset: int, more: bool, part: bytes, stamp_ns: int) -> bytes | None:
        """One part at its offset, captured at UTC ns; the whole when it is complete, else None."""
        parts = self._waiting.get(key)
        if parts is None or self._is_of_another(parts, offset, part, stamp_ns):
            self._waiting.pop(key, None)  # so that the new one is the newest of those that wait
            parts = self._waiting[key] = _Parts()
        parts.by_offset[offset] = part
        parts.newest_ns = stamp_ns
        if not more:
            parts.length = offset + len(part)
        whole = parts.whole()
        if whole is not None:
            self._waiting.pop(key)
        elif len(self._waiting) > _MAX_FRAGMENTED:
            self._waiting.pop(next(iter(self._waiting)))
        return whole

    @staticmethod
    def _is_of_another(parts: _Parts, offset: int, part: bytes, stamp_ns: int) -> bool:
        """Whether the part is of another packet than those that wait. A mirror port may send the same part twice."""
        begins_anew = offset == 0 and parts.by_offset.get(0, part) != part
        return begins_anew or abs(stamp_ns - parts.newest_ns) > _FRAGMENTS_WAIT_NS


def _udp(packet: bytes, fragments: Fragments, stamp_ns: int) -> tuple[str, int, bytes] | None:
    """(sender, port, payload) of a complete UDP packet, else None."""
    version = packet[0] >> 4 if packet else 0
    read = {4: _ipv4, 6: _ipv6}.get(version)
    body = read(packet, fragments, stamp_ns) if read else None
    if body is None or len(body) < 8:
        return None
    port, length = struct.unpack_from(">HH", body, 2)
    sender = packet[12:16] if version == 4 else packet[8:24]
    return str(ip_address(sender)), port, body[8 : length or None]


def _ipv4(packet: bytes, fragments: Fragments, stamp_ns: int) -> bytes | None:
    if len(packet) < 20 or packet[9] != _UDP:
        return None
    total, identity, flags = struct.unpack_from(">HHH", packet, 2)
    body = packet[(packet[0] & 15) * 4 : total or None]  # 0: the network card cut the packet, and left no length
    offset, more = (flags & 0x1FFF) * 8, bool(flags & 0x2000)
    if not (offset or more):
        return body
    return fragments.add((packet[12:20], identity), offset, more, body, stamp_ns)


def _ipv6(packet: bytes, fragments: Fragments, stamp_ns: int) -> bytes | None:
    if len(packet) < 48:
        return None
    length, following = struct.unpack_from(">HB", packet, 4)
    body = packet[40 : 40 + length if length else None]
    if following == _UDP:
        return body
    if following != _IPV6_FRAGMENT or len(body) < 8 or body[0] != _UDP:
        return None
    flags, identity = struct.unpack_from(">HI", body, 2)
    return fragments.add((packet[8:40], identity), flags & 0xFFF8, bool(flags & 1), body[8:], stamp_ns)
