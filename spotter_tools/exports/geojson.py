"""Recorded tracks as GeoJSON (RFC 7946): the way of each road user as one line, with its times. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

from common.geodesy import MapOrigin
from common.geojson import MAP_FRAME, Json, collection, feature, positions, properties
from common.messages import ObjectTracks


@dataclass
class _Way:
    points_m: list[tuple[float, float, float]] = field(default_factory=list)
    stamps_ns: list[int] = field(default_factory=list)
    speeds_mps: list[float] = field(default_factory=list)
    labels: Counter[str] = field(default_factory=Counter)
    newest: Json = field(default_factory=dict)


def ways(recorded: Iterable[tuple[str, ObjectTracks]], origin: MapOrigin, counts: Counter[str]) -> Json:
    """A Feature for each track: a LineString, or a Point where it was seen once.

    ``stamps_ns`` and ``speeds_mps`` have an entry for each position; ``label`` is the one it had most often, the other
    properties are the last ones. Messages in another frame than the map are left out. ``counts``: those and the tracks.
    """
    found: dict[tuple[str, int], _Way] = {}
    for host, message in recorded:
        if message.frame_id not in ("", MAP_FRAME):
            counts[f"messages in the frame {message.frame_id}, not {MAP_FRAME}, left out"] += 1
            continue
        for track in message.tracks:
            way = found.setdefault((host, track.track_id), _Way())
            way.newest = properties(host, message, track, origin)
            way.points_m.append(track.position_m)
            way.stamps_ns.append(message.stamp_ns)
            way.speeds_mps.append(way.newest["speed_mps"])
            way.labels[track.label] += 1
    counts["tracks"] += len(found)
    return collection(_feature(way, origin) for way in found.values())


def _feature(way: _Way, origin: MapOrigin) -> Json:
    places = positions(way.points_m, origin)
    about = way.newest | {"label": way.labels.most_common(1)[0][0]}
    about |= {"stamps_ns": way.stamps_ns, "speeds_mps": way.speeds_mps}
    if len(places) == 1:
        return feature("Point", places[0], about)
    return feature("LineString", places, about)
