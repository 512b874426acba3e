"""Recorded tracks as ASAM OpenLABEL 1.0.0: objects with a cuboid in each frame. Pure.

A frame is one message. The coordinate system is the tracks' own frame, the site's map: x, y level, z up, metres.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from datetime import UTC, datetime
from typing import Any

from common.geodesy import MapOrigin
from common.messages import ObjectTrack, ObjectTracks, SourceKind, least_live

Json = dict[str, Any]


def annotation(
    recorded: Iterable[tuple[str, ObjectTracks]], origin: MapOrigin | None, name: str, counts: Counter[str]
) -> Json:
    """The document. ``counts`` gets its objects and frames."""
    uids: dict[tuple[str, int], int] = {}
    labels: dict[int, Counter[str]] = {}
    seen: dict[int, list[int]] = {}
    frames: Json = {}
    kinds: set[SourceKind] = set()
    systems: Json = {}
    for number, (host, message) in enumerate(recorded):
        objects, system = {}, message.frame_id or "map"
        kinds.add(message.source_kind)
        systems[system] = {"type": "scene_cs", "parent": "", "children": []}
        for track in message.tracks:
            uid = uids.setdefault((host, track.track_id), len(uids))
            labels.setdefault(uid, Counter())[track.label] += 1
            seen.setdefault(uid, []).append(number)
            objects[str(uid)] = {"object_data": {"cuboid": [_cuboid(track, system)]}}
        about = {"timestamp": _iso(message.stamp_ns), "stamp_ns": message.stamp_ns, "host": host}
        frames[str(number)] = {"frame_properties": about} | ({"objects": objects} if objects else {})
    counts.update(objects=len(uids), frames=len(frames))
    document = {
        "metadata": _metadata(name, least_live(kinds), origin),
        "coordinate_systems": systems,
        "frames": frames,
        "frame_intervals": [{"frame_start": 0, "frame_end": len(frames) - 1}] if frames else [],
        "objects": {
            str(uid): {
                "name": f"{host}/{track_id}",
                "type": labels[uid].most_common(1)[0][0],
                "frame_intervals": _intervals(seen[uid]),
            }
            for (host, track_id), uid in uids.items()
        },
    }
    return {"openlabel": document}


def _metadata(name: str, kind: SourceKind, origin: MapOrigin | None) -> Json:
    """Whose tracks these are, and that no person has labelled them."""
    about: Json = {
        "schema_version": "1.0.0",
        "name": name,
        "annotator": "Spotter's tracker, unattended",
        "comment": f"tracks of a roadside lidar, not labels of a person; data: {kind}",
        "source_kind": kind,
    }
    if origin is not None:
        about["map_origin_wgs84"] = {
            "latitude_deg": origin.latitude_deg,
            "longitude_deg": origin.longitude_deg,
            "altitude_m": origin.altitude_m,
            "heading_deg": origin.heading_deg,
        }
    return about


def _cuboid(track: ObjectTrack, system: str) -> Json:
    """x y z, Euler angles about x, y, z, and length, width, height."""
    numbers = {
        "label_confidence": track.label_confidence,
        "vx_mps": track.velocity_mps[0],
        "vy_mps": track.velocity_mps[1],
        "vz_mps": track.velocity_mps[2],
        "points": track.points,
    }
    words = {"label": track.label, "state": track.state}
    return {
        "name": "box",
        "val": [*track.position_m, 0.0, 0.0, track.yaw_rad, *track.size_m],
        "coordinate_system": system,
        "attributes": {
            "num": [{"name": key, "val": value} for key, value in numbers.items()],
            "text": [{"name": key, "val": value} for key, value in words.items()],
        },
    }


def _intervals(frames: list[int]) -> list[Json]:
    """Runs of neighbouring frames."""
    runs: list[Json] = []
    for frame in frames:
        if runs and frame == runs[-1]["frame_end"] + 1:
            runs[-1]["frame_end"] = frame
        else:
            runs.append({"frame_start": frame, "frame_end": frame})
    return runs


def _iso(stamp_ns: int) -> str:
    """UTC with nanoseconds, ISO 8601."""
    whole, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(whole, UTC):%Y-%m-%dT%H:%M:%S}.{nanoseconds:09d}Z"
