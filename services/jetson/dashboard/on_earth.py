"""What the roadside lidars track now as GeoJSON. Pure."""

from __future__ import annotations

from collections.abc import Iterable

from common.geodesy import MapOrigin
from common.geojson import MAP_FRAME, Json, collection, points
from common.messages import Message, ObjectTracks
from common.topics import INFRA_TRACKS


def live_tracks(newest: Iterable[tuple[str, Message, float]], origin: MapOrigin) -> Json:
    """A Point for each track, of (key, message, age in seconds). Beside them, by host, whether its word is used.

    Tracks older than the topic's limit are left out and their host is called stale: an empty collection of a host that
    is silent says nothing of the road.
    """
    features: list[Json] = []
    hosts: Json = {}
    for key, message, age_s in newest:
        if not isinstance(message, ObjectTracks):
            continue
        fresh = age_s <= (INFRA_TRACKS.age_limit_s or 0.0)
        in_map = message.frame_id in ("", MAP_FRAME)
        state = (
            "stale" if not fresh else message.state if in_map else f"in the frame {message.frame_id}, not {MAP_FRAME}"
        )
        about = {
            "state": state,
            "reason": message.reason,
            "age_ms": round(age_s * 1e3, 1),
            "stamp_ns": message.stamp_ns,
        }
        hosts[key.partition("/")[0]] = about | {"source_kind": message.source_kind}
        if fresh and in_map:
            features += points(key, message, origin)
    return collection(features, hosts=hosts)
