"""Packets as a live source: UDP, received in a thread of its own. Opens sockets and reads the clock."""

from __future__ import annotations

import queue
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from ipaddress import IPv4Address

from common.bus.status import Report
from common.clock import monotonic_s, utc_ns, utc_of_kernel
from common.config import ConfigError
from common.source_url import SourceUrl, port_in
from services.infra_lidar.input.arrivals import Arrivals
from services.infra_lidar.input.calibration_files import asked_metadata, named_metadata
from services.infra_lidar.input.models import KINDS
from services.infra_lidar.input.packets import Frame, ParserCounts, count_losses, frame_of
from services.infra_lidar.input.revolution import Revolution
from services.infra_lidar.input.spinning import PacketParser

RECEIVE_BUFFER_BYTES = 8 << 20  # a fifth of a second of a 128-beam sensor; the kernel may grant less
# Of the kernel's buffer, by the packets of one pause: small ones take twice their size, and reading may be late.
MAX_FILL_SHARE = 0.125
SHORTEST_PAUSE_S = 0.001
SILENCE_S = 1.0
READ_EVERY_S = 0.02  # more often takes more of the processor: waking up for packets takes longer than reading them
READ_AT_ONCE = 4096  # packets, more than any sensor sends in this time
MAX_PACKET_BYTES = 65535
STAMP_PACKETS = 35  # Linux's SO_TIMESTAMPNS, which Python does not name: the kernel stamps what comes
STAMP = struct.Struct("@ll")  # seconds, nanoseconds
STAMP_SPACE = socket.CMSG_SPACE(STAMP.size)
WAITING_FRAMES = 2  # older ones are dropped: a late frame is worth less than the next


def live_packets(url: SourceUrl, report: Report) -> Iterator[tuple[int, Frame]]:
    """``velodyne://:2368`` listens there; ``KIND://HOST`` first asks that sensor for what its packets do not say.

    A sensor that sends to a multicast group: ``velodyne://GROUP:2368``, ``KIND://HOST?group=GROUP``. What the source
    says is checked here. The network is needed only when the first frame is asked for.

    Raises:
        ConfigError: no port, not a number, or a file that cannot be read. Asking for a frame: an address that cannot be
            listened at, or a sensor that does not tell its metadata.
    """
    kind, cut_deg = KINDS[url.scheme], url.number("cut", 0.0)
    if url.scheme == "velodyne":
        host, _, port_text = url.target.rpartition(":")
        port, sensor = port_in(port_text, f"source {url}: PORT of velodyne://[ADDRESS]:PORT"), ""
    else:
        host, port, sensor = _group(url), url.port("port", kind.port), url.target
    named = named_metadata(url)

    def listen() -> Receiver:
        parser = kind.parser(asked_metadata(url) if named is None else named, cut_deg)
        return Receiver(host, port, parser, report, url.params.get("from", "") or _address_of(sensor))

    return _revolutions(listen, report)


def _group(url: SourceUrl) -> str:
    """The multicast group that the source names, "" where it names none."""
    group = url.params.get("group", "")
    if group and not _is_group(group):
        raise ConfigError(f"source {url}: group={group}: expected a multicast address, 224.0.0.0 to 239.255.255.255")
    if _is_group(url.target):
        raise ConfigError(
            f"source {url}: {url.target} is a multicast group: {url.scheme}://SENSOR?group={url.target}, "
            f"where SENSOR is the sensor's own address"
        )
    return group


def _is_group(address: str) -> bool:
    try:
        return IPv4Address(address).is_multicast
    except ValueError:
        return False  # a name, or no address


def _revolutions(listen: Callable[[], Receiver], report: Report) -> Iterator[tuple[int, Frame]]:
    receiver = listen()
    try:
        while True:
            revolution = receiver.next(SILENCE_S)
            if revolution is None:
                report.state("disconnected", receiver.why_nothing())
                receiver.forget_sender()
                continue
            yield revolution.stamp_ns, frame_of(revolution)
    finally:
        receiver.close()


def _address_of(host: str) -> str:
    """The sensor's address; "" (any sender) where its name cannot be resolved now."""
    try:
        return socket.gethostbyname(host) if host else ""
    except OSError:
        return ""


def _arrival_ns(stamps: list[tuple[int, int, bytes]]) -> int:
    """UTC ns at which a packet came, as the kernel says beside it; now, where it says nothing."""
    if not stamps:
        return utc_ns()
    second, nanosecond = STAMP.unpack(stamps[0][2])
    return utc_of_kernel(second * 1_000_000_000 + nanosecond)


def pause_after(pause_s: float, came_bytes: int, buffer_bytes: int) -> float:
    """Seconds until the next read, after one that found ``came_bytes`` and was ``pause_s`` after the one before.

    READ_EVERY_S, or less where that would fill more than MAX_FILL_SHARE of the kernel's buffer.
    """
    fitting_s = pause_s * MAX_FILL_SHARE * buffer_bytes / max(came_bytes, 1)
    return min(READ_EVERY_S, max(SHORTEST_PAUSE_S, fitting_s))


class Receiver:
    """Reads a UDP port in its own thread, so that the socket's buffer does not overflow while the pipeline works.

    host: the address to listen at, or a multicast group to join; empty = any. sender: the only address that is
    listened to; empty = the first one whose packets are of the parser's kind.

    Raises:
        ConfigError: the port is taken or out of range, or the address is not one of this machine.
    """

    def __init__(self, host: str, port: int, parser: PacketParser, report: Report, sender: str = "") -> None:
        self._parser = parser
        self._report = report
        self._configured = self._sender = sender
        self._counts = ParserCounts(report)
        self._frames: queue.Queue[Revolution] = queue.Queue(WAITING_FRAMES)
        self._failure: Exception | None = None
        self._stop = threading.Event()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
        timeout = struct.pack("@ll", 0, 200_000)  # the kernel's: Python's asks it twice for every packet
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, timeout)
        with suppress(OSError):  # a system without it: packets have the time at which they are read
            self._socket.setsockopt(socket.SOL_SOCKET, STAMP_PACKETS, 1)
        try:
            group = _is_group(host)
            self._socket.bind(("" if group else host, port))
            if group:
                self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(host) + bytes(4))
        except (OSError, ValueError, OverflowError) as error:
            self._socket.close()
            raise ConfigError(f"cannot listen on UDP port {port}: {error}") from None
        self.port: int = self._socket.getsockname()[1]
        self._buffer_bytes = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        self._came_bytes = 0  # with the last read, packets of others included
        self._arrivals = Arrivals(self.port)
        self._thread = threading.Thread(target=self._run, name="packets", daemon=True)
        self._thread.start()

    def next(self, timeout_s: float) -> Revolution | None:
        """The next revolution; None if none is complete within ``timeout_s``.

        Raises:
            Exception: what has ended the receiving thread.
        """
        try:
            return self._frames.get(timeout=timeout_s)
        except queue.Empty:
            if self._failure is not None:
                raise self._failure from None
            return None

    def close(self) -> None:
        """End the thread and close the socket."""
        self._stop.set()
        self._thread.join(1.0)
        self._socket.close()

    def why_nothing(self) -> str:
        """Why no revolution comes, as a sentence for a person. See ``Arrivals``."""
        return self._arrivals.why_nothing(monotonic_s())

    def forget_sender(self) -> None:
        """Take the next sender of fitting packets, unless one was configured: the sensor may have a new address."""
        self._sender = self._configured
        self._arrivals.forget()

    def _run(self) -> None:
        """The thread. What ends it is kept for ``next``: silence would look like a sensor that does not send."""
        try:
            self._receive()
        except Exception as error:  # noqa: BLE001  whatever it is, it is raised where somebody waits
            self._failure = error

    def _receive(self) -> None:
        """Take the packets that have come, then let more of them come."""
        pause_s = SHORTEST_PAUSE_S
        while not self._stop.is_set():
            self._take(*self._arrived())
            self._counts.update(self._parser)
            pause_s = pause_after(pause_s, self._came_bytes, self._buffer_bytes)
            time.sleep(pause_s)

    def _arrived(self) -> tuple[str, list[bytes], list[int]]:
        """The sensor's address, its packets and the UTC ns at which each came; those of others are counted.

        Waits for the first packet, at most the time-out.

        Raises:
            OSError: the socket is of no more use.
        """
        sender, flags, self._came_bytes = "", 0, 0
        packets: list[bytes] = []
        stamps_ns: list[int] = []
        for _ in range(READ_AT_ONCE):
            try:
                packet, stamps, _, (address, *_) = self._socket.recvmsg(MAX_PACKET_BYTES, STAMP_SPACE, flags)
            except BlockingIOError:
                break  # nothing came in time, or nothing more is there
            except OSError:
                if self._stop.is_set():
                    break  # closed
                raise
            flags = socket.MSG_DONTWAIT
            self._came_bytes += len(packet)
            if address == self._sender or not self._is_stranger(address, packet):
                sender = address
                packets.append(packet)
                stamps_ns.append(_arrival_ns(stamps))
        return sender, packets, stamps_ns

    def _take(self, sender: str, packets: list[bytes], stamps_ns: list[int]) -> None:
        """Packets of the sensor; those that cannot be used are counted."""
        before = self._parser.rejected
        revolutions = self._parser.feed_all(packets, stamps_ns)
        unfit = self._parser.rejected - before
        for packet in packets if unfit else ():
            if not self._parser.accepts(packet):
                self._arrivals.unfit(sender, packet)
        if unfit < len(packets):
            self._arrivals.fitting(monotonic_s())
        for revolution in revolutions:
            self._counts.update(self._parser)
            count_losses(revolution.quality, self._report)
            self._arrivals.forget()
            self._offer(revolution)

    def _is_stranger(self, address: str, packet: bytes) -> bool:
        """Whether a packet of another sender than the sensor is to be left out; it is counted.

        As long as there is no sensor, the first sender of fitting packets becomes it.
        """
        if not self._sender and self._parser.accepts(packet):
            self._sender = address
            return False
        self._arrivals.stranger(address, packet)
        self._report.bad_input("packet of another sensor" if self._parser.accepts(packet) else "packet of another kind")
        return True

    def _offer(self, revolution: Revolution) -> None:
        """Queue it, in place of the oldest one, which is counted, if the queue is full."""
        try:
            self._frames.put_nowait(revolution)
        except queue.Full:
            with suppress(queue.Empty):  # taken at this very moment
                self._frames.get_nowait()
                self._report.dropped()
            self._frames.put_nowait(revolution)
