"""Tracks to visualization_msgs/MarkerArray, for RViz. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from common import messages as m
from common.recording.colours import COLOURS
from common.ros2.types import build, header, time_of
from spotter_tools.ros2.geometry import MAP, colour, pose, vector

MARKERS = "visualization_msgs/msg/MarkerArray"
ARROW, CUBE, SPHERE, TEXT = 0, 1, 2, 9
LIFETIME_NS = 500_000_000
MOVES_MPS = 0.3
WHITE = (1.0, 1.0, 1.0)


def object_markers(message: m.ObjectTracks, host: str) -> Any:
    """A box, a name with its speed, and an arrow of one second's way for every track."""
    head, markers = header(message.stamp_ns, message.frame_id or MAP), []
    for track in message.tracks:
        rgb, alpha = COLOURS[track.label], 0.35 if track.state == "coasting" else 0.7
        markers.append(_marker(head, "objects", track.track_id, CUBE, pose(track.position_m, track.yaw_rad),
                               track.size_m, colour(rgb, alpha)))  # fmt: skip
        speed_mps = math.hypot(*track.velocity_mps[:2])
        if speed_mps > MOVES_MPS:
            heading_rad = math.atan2(track.velocity_mps[1], track.velocity_mps[0])
            markers.append(_marker(head, "velocity", track.track_id, ARROW, pose(track.position_m, heading_rad),
                                   (speed_mps, 0.15, 0.15), colour(rgb, alpha)))  # fmt: skip
        x, y, z = track.position_m
        words = f"{track.label} {track.track_id} {speed_mps:.1f} m/s"
        markers.append(_text(head, track.track_id, (x, y, z + track.size_m[2] / 2 + 0.5), words, 0.5))
    return build(MARKERS, markers=markers)


def radar_markers(message: m.RadarTracks, host: str) -> Any:
    """A ball in the colour of its level and its closing speed for every track, in the radar's frame."""
    head, markers = header(message.stamp_ns, "radar"), []
    for track in message.tracks:
        azimuth_rad = track.azimuth_rad or 0.0
        at_m = (track.range_m * math.cos(azimuth_rad), track.range_m * math.sin(azimuth_rad), 0.0)
        markers.append(_marker(head, "radar", track.track_id, SPHERE, pose(at_m, 0.0), (0.2, 0.2, 0.2),
                               colour(COLOURS[track.level], 0.8)))  # fmt: skip
        words = f"#{track.track_id} {track.velocity_mps:+.1f} m/s"
        markers.append(_text(head, track.track_id, (at_m[0], at_m[1], 0.25), words, 0.1))
    return build(MARKERS, markers=markers)


def _marker(head: Any, group: str, number: int, kind: int, *about: Any) -> Any:
    where, size, paint = about
    return build(
        "visualization_msgs/msg/Marker", header=head, ns=group, id=number % 2**31, type=kind, pose=where,
        scale=vector(size), color=paint, lifetime=_duration(LIFETIME_NS),
    )  # fmt: skip


def _text(head: Any, number: int, at_m: Sequence[float], words: str, height_m: float) -> Any:
    marker = _marker(head, "names", number, TEXT, pose(at_m, 0.0), (0.0, 0.0, height_m), colour(WHITE, 1.0))
    marker.text = words
    return marker


def _duration(ns: int) -> Any:
    time = time_of(ns)
    return build("builtin_interfaces/msg/Duration", sec=time.sec, nanosec=time.nanosec)
