"""Recorded tracks as KITTI tracking results: one line for each track and frame, 18 columns. Pure.

KITTI's boxes stand in a camera's frame (x right, y down, z forward). There is no camera here: it is thought into the
map's origin, looking along the map's x axis, so x = -y, y = -z, z = x of the map, and the columns of a picture say
"unknown" in KITTI's own way. Format: Geiger et al., KITTI tracking devkit, readme.txt.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator

from common.geojson import MAP_FRAME
from common.messages import ObjectTrack, ObjectTracks

KINDS = {"car": "Car", "large_vehicle": "Truck", "cyclist": "Cyclist", "pedestrian": "Pedestrian"}
_UNKNOWN = "-1 -1 -10 -1 -1 -1 -1"  # truncated, occluded, alpha, box in the picture


def lines(recorded: Iterable[tuple[str, ObjectTracks]], counts: Counter[str]) -> Iterator[str]:
    """The lines of one host's messages; the frame is the number of the message.

    Messages in another frame than the map are left out, and counted.
    """
    for frame, (_, message) in enumerate(recorded):
        if message.frame_id not in ("", MAP_FRAME):
            counts[f"messages in the frame {message.frame_id}, not {MAP_FRAME}, left out"] += 1
            continue
        counts["frames"] += 1
        for track in message.tracks:
            counts["lines"] += 1
            yield _line(frame, track)


def _line(frame: int, track: ObjectTrack) -> str:
    """KITTI's place is the middle of the bottom; its angle is from the camera's x axis, about y, downwards."""
    (x, y, z), (length, width, height) = track.position_m, track.size_m
    turn = math.remainder(-track.yaw_rad - math.pi / 2.0, math.tau)
    numbers = (height, width, length, -y, height / 2.0 - z, x, turn, track.score)
    name = KINDS.get(track.label, "Misc")
    return f"{frame} {track.track_id} {name} {_UNKNOWN} " + " ".join(f"{value:.6f}" for value in numbers)
