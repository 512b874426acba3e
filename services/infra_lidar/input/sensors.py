"""Which lidar sends a packet: told by its size and its first and last bytes. Bytes in, names out; no I/O.

Sources: Velodyne user manuals (VLP-16 63-9243, HDL-32E 63-9113, VLS-128 63-9483: factory bytes at the end of a data
packet); Hesai "UDP Data Packet" chapters (start bytes 0xEE 0xFF, protocol version, number of lasers); RoboSense MSOP
headers and flags of blocks; Ouster "Lidar Data Format" (packet sizes by profile and number of beams).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import NamedTuple

from services.infra_lidar.input import hesai, robosense
from services.infra_lidar.input.captures import Datagram
from services.infra_lidar.input.ouster_profiles import PROFILES
from services.infra_lidar.input.velodyne import DUAL_RETURN, MODE_AT

VELODYNE_BYTES = 1206
VLS128 = "Velodyne VLS-128"
OUSTER = "Ouster"
PANDAR128 = "Hesai Pandar128E3X or OT128"  # one protocol, alike in every byte
QT128 = "Hesai QT128"
RUBY, RUBY_PLUS = "RoboSense Ruby", "RoboSense Ruby Plus"
SUPPORTED = (VLS128, OUSTER, PANDAR128, QT128, RUBY_PLUS, RUBY)
SURVEY_PACKETS = 5000  # several revolutions of a few sensors

_VELODYNE = {0x21: "HDL-32E", 0x22: "VLP-16", 0x24: "Puck Hi-Res", 0x28: "VLP-32C", 0x31: "Velarray", 0xA1: "VLS-128"}
HESAI_MODELS = {(1, 4, 128): PANDAR128, (3, 2, 128): QT128}  # by version of the protocol and beams
_ROBOSENSE = {
    b"\x55\xaa\x05\x5a": "RoboSense (RS-80 or Helios kind)",
    b"\x55\xaa\x05\x0a": "RoboSense (RS-16, RS-32 or BPearl kind)",
    b"\x55\xaa\x5a\xa5": "RoboSense (RS-M1 kind)",
}
_OUSTER_COLUMNS = 16


def _ouster_sizes() -> dict[int, str]:
    """Sizes of packets; profiles of one size cannot be told apart by it, the first stands for all."""
    sizes: dict[int, str] = {}
    for beams in (16, 32, 64, 128):
        for name, p in PROFILES.items():
            others = [k for k, q in PROFILES.items() if (q.pixel, q.legacy) == (p.pixel, p.legacy)]
            words = f"with {beams} beams, {name}" + (" or of that size" if len(others) > 1 else "")
            sizes.setdefault(p.packet_bytes(_OUSTER_COLUMNS, beams), words)
    return sizes


def _ouster_duals() -> dict[int, set[bool]]:
    """By size of a packet: whether the profiles of that size have a second return."""
    duals: dict[int, set[bool]] = {}
    for beams in (16, 32, 64, 128):
        for p in PROFILES.values():
            duals.setdefault(p.packet_bytes(_OUSTER_COLUMNS, beams), set()).add(p.second_range_at >= 0)
    return duals


_OUSTER_SIZES, _OUSTER_DUALS = _ouster_sizes(), _ouster_duals()


class Sender(NamedTuple):
    """A sensor on the network: its address, the port it sends to, and what its packets look like."""

    address: str
    port: int
    model: str  # "" = not known

    @property
    def supported(self) -> bool:
        """Whether this service decodes its packets."""
        return self.model.startswith(SUPPORTED)

    def __str__(self) -> str:
        what = self.model or "an unknown device"
        return f"{what} at {self.address}, port {self.port}" + ("" if self.supported else " (not supported)")


def model_of(payload: bytes) -> str:
    """The sensor that a packet comes from; "" where nothing is known of it."""
    if len(payload) == VELODYNE_BYTES and payload[0] == 0xFF:
        product = payload[-1]
        return f"Velodyne {_VELODYNE.get(product, f'of product number 0x{product:02X}')}"
    if payload[:2] == b"\xee\xff" and len(payload) > 100:
        major, minor, beams = payload[2], payload[3], payload[6]
        if (major, minor) == (3, 2) and payload[11] & hesai.SELECTED_CHANNELS:
            return "Hesai QT with selected channels"
        return HESAI_MODELS.get((major, minor, beams), f"Hesai with {beams} beams, protocol {major}.{minor}")
    if robosense.is_msop(payload):
        return RUBY_PLUS if robosense.is_plus(payload) else RUBY
    if payload[:4] in _ROBOSENSE and len(payload) > 100:
        return _ROBOSENSE[payload[:4]]
    return f"{OUSTER} {_OUSTER_SIZES[len(payload)]}" if len(payload) in _OUSTER_SIZES else ""


def returns_of(payload: bytes) -> str:
    """``single return`` or ``dual return``; "" where the packet does not tell, or where we do not know its format."""
    model = model_of(payload)
    if model == VLS128:
        duals = {payload[MODE_AT] == DUAL_RETURN}
    elif model in (PANDAR128, QT128):
        duals = {hesai.is_dual(payload)}
    elif model in (RUBY, RUBY_PLUS):
        duals = {robosense.is_dual(payload)}
    else:
        duals = _OUSTER_DUALS.get(len(payload), set()) if model.startswith(OUSTER) else set()
    if len(duals) != 1:
        return ""
    return "dual return" if True in duals else "single return"


def survey(datagrams: Iterable[Datagram]) -> Counter[Sender]:
    """How many packets each sensor has sent; devices that are no lidar are left out."""
    found: Counter[Sender] = Counter()
    for datagram in datagrams:
        model = model_of(datagram.payload)
        if model:
            found[Sender(datagram.sender, datagram.port, model)] += 1
    return found
