"""Polygon files (PLY 1.0, Turk 1994) to arrays: ascii and binary of either byte order. Bytes in, arrays out; no I/O.

Of the file only the element ``vertex`` is read; its properties have to be numbers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from services.infra_lidar.input.pcd import MAX_POINTS, FrameError, point_columns, text_table

_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip
_ORDER = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}
_INTENSITY, _RING = ("intensity", "scalar_intensity", "reflectivity"), ("ring", "scalar_ring", "channel")
LONGEST_HEADER = 20_000


class _Element(NamedTuple):
    name: str
    number: int
    properties: dict[str, str]  # name -> numpy type, "" for a list


def parse_ply(data: bytes) -> np.ndarray:
    """(N, 3..5) float32: x, y, z, intensity (0..255) and ring, where the file has them.

    Raises:
        FrameError: no PLY, damaged, without coordinates, or points that are lists.
    """
    form, elements, body = _header(data)
    vertex = next((element for element in elements if element.name == "vertex"), None)
    if vertex is None:
        raise FrameError("no element vertex")
    before = elements[: elements.index(vertex)]
    lists = [f"{e.name}.{name}" for e in (*before, vertex) for name, kind in e.properties.items() if not kind]
    if lists:
        raise FrameError(f"{lists[0]} is a list: points of single numbers are expected")
    missing = [axis for axis in "xyz" if axis not in vertex.properties]
    if missing:
        raise FrameError(f"no property {' and '.join(missing)} among {' '.join(vertex.properties)}")
    if not 0 < vertex.number <= MAX_POINTS:
        raise FrameError(f"{vertex.number} points")
    rows = _ascii(body, before, vertex) if form == "ascii" else _binary(body, before, vertex, _ORDER[form])
    intensity = next((rows[name] for name in _INTENSITY if name in vertex.properties), None)
    if intensity is not None:
        intensity = np.clip(np.nan_to_num(intensity), 0, 255)
    ring = next((rows[name] for name in _RING if name in vertex.properties), None)
    return point_columns([rows[axis] for axis in "xyz"], intensity, ring)


def _header(data: bytes) -> tuple[str, list[_Element], bytes]:
    end = data[:LONGEST_HEADER].find(b"end_header")
    if data[:3] != b"ply" or end < 0:
        raise FrameError("no header of a PLY file")
    form, elements = "", []
    for line in data[:end].decode("ascii", "replace").splitlines()[1:]:
        words = line.split()
        if words[:1] == ["format"] and len(words) > 1:
            form = words[1]
        elif words[:1] == ["element"] and len(words) == 3 and words[2].isdigit():
            elements.append(_Element(words[1], int(words[2]), {}))
        elif words[:1] == ["property"] and elements:
            is_list = words[1:2] == ["list"]
            if not is_list and (len(words) != 3 or words[1] not in _TYPES):
                raise FrameError(f"{line.strip()!r} is no property of PLY")
            name = words[-1].lower()
            if name in elements[-1].properties:
                raise FrameError(f"property {name} twice in element {elements[-1].name}, expected once")
            elements[-1].properties[name] = "" if is_list else _TYPES[words[1]]
        elif words and words[0] not in ("comment", "obj_info"):
            raise FrameError(f"{line.strip()!r} is no line of a PLY header")
    if form not in _ORDER:
        raise FrameError(f"format {form or 'missing'}: expected {', '.join(_ORDER)}")
    return form, elements, data[data.find(b"\n", end) + 1 :] if b"\n" in data[end:] else b""


def _record(element: _Element, order: str) -> np.dtype:
    return np.dtype([(name, order + kind) for name, kind in element.properties.items()])


def _binary(body: bytes, before: list[_Element], vertex: _Element, order: str) -> np.ndarray:
    start = sum(element.number * _record(element, order).itemsize for element in before)
    record = _record(vertex, order)
    if len(body) < start + vertex.number * record.itemsize:
        raise FrameError(
            f"{vertex.number} points of {record.itemsize} bytes are announced, {max(0, len(body) - start)} bytes follow"
        )
    return np.frombuffer(body, record, vertex.number, start)


def _ascii(body: bytes, before: list[_Element], vertex: _Element) -> np.ndarray:
    skipped = sum(element.number for element in before)
    table = text_table(body, skipped, vertex.number, len(vertex.properties))
    rows = np.empty(vertex.number, [(name, "f8") for name in vertex.properties])
    for k, name in enumerate(vertex.properties):
        rows[name] = table[:, k]
    return rows
