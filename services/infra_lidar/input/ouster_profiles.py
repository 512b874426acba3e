"""Byte layouts of Ouster's lidar packets, by the names of their profiles, firmware 2.x and 3.x. Data only.

From Ouster's "Firmware User Manual", "Lidar Data Format", and checked against ouster-sdk 1.0.1 bit by bit. Where the
two disagree: a LEGACY reflectivity has 16 bits in manuals of firmware 1.x and 8 in the SDK; both are read, larger ones
as 255.
"""

from __future__ import annotations

from typing import NamedTuple


class OusterProfile(NamedTuple):
    """Sizes in bytes; where in a pixel the first return's range and reflectivity lie, and the second's (-1: none)."""

    packet_header: int
    column_header: int
    column_footer: int
    packet_footer: int
    pixel: int
    range_type: str
    range_mask: int
    range_step_mm: int
    reflectivity_at: int
    reflectivity_type: str
    second_range_at: int = -1
    second_reflectivity_at: int = -1

    @property
    def legacy(self) -> bool:
        """Whether it is the layout of firmware 1.x, without a packet header."""
        return self.packet_header == 0

    def column_bytes(self, beams: int) -> int:
        """The size of a column with its header and footer."""
        return self.column_header + beams * self.pixel + self.column_footer

    def packet_bytes(self, columns: int, beams: int) -> int:
        """The size of a packet with so many columns of so many beams."""
        return self.packet_header + columns * self.column_bytes(beams) + self.packet_footer


def _fine(pixel: int, reflectivity_at: int, dual: bool = False) -> OusterProfile:
    """19 bits of millimetres."""
    second = (4, 7) if dual else (-1, -1)
    return OusterProfile(32, 12, 0, 32, pixel, "<u4", 0x0007FFFF, 1, reflectivity_at, "u1", *second)


def _coarse(pixel: int, dual: bool = False) -> OusterProfile:
    """15 bits of 8 mm; the sixteenth is a flag."""
    second = (4, 6) if dual else (-1, -1)
    return OusterProfile(32, 12, 0, 32, pixel, "<u2", 0x7FFF, 8, 2, "u1", *second)


PROFILES = {
    "LEGACY": OusterProfile(0, 16, 4, 0, 12, "<u4", 0x000FFFFF, 1, 4, "<u2"),
    "RNG19_RFL8_SIG16_NIR16": _fine(12, 4),
    "RNG19_RFL8_SIG16_NIR16_DUAL": _fine(16, 3, dual=True),
    "RNG15_RFL8_NIR8": _coarse(4),
    "RNG15_RFL8_NIR8_DUAL": _coarse(8, dual=True),
    "FUSA_RNG15_RFL8_NIR8_DUAL": _coarse(8, dual=True),
    "RNG15_RFL8_WIN8": _coarse(4),
    "RNG15_RFL8_NIR8_ZONE16": _coarse(8),
    "RNG19_RFL8_SIG16_NIR16_ZONE16": _fine(12, 4),
    "RNG19_RFL8_SIG16_ZONE16_DUAL": _fine(16, 3, dual=True),
    "RNG19_RFL8_SIG16_NIR16_RGB16": _fine(16, 3),
    "RNG19_RFL8_SIG16_NIR16_RGB16_DUAL": _fine(20, 3, dual=True),
    "FIVE_WORD_PIXEL": _fine(20, 3, dual=True),
}


PACKET_TYPES = {10: b"", 2: b"\1\0", 4: b"\1"}  # a lidar packet's first bytes, by ``frame_id_at``; LEGACY has none


def frame_id_at(profile_name: str, header_type: str) -> int:
    """Where the low 16 bits of the frame's number lie in a packet.

    header_type: what the metadata say, "" = nothing; then packets of a FUSA profile have the header of that name.
    """
    if PROFILES[profile_name].legacy:
        return 10  # in the first column
    fusa = header_type == "FUSA" or (not header_type and profile_name.startswith("FUSA"))
    return 4 if fusa else 2
