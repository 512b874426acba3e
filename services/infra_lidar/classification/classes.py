"""The classes of the roadside lidar, in the order of every probability row."""

from __future__ import annotations

from common.messages import ObjectLabel

CLASSES: tuple[ObjectLabel, ...] = ("background", "car", "large_vehicle", "cyclist", "pedestrian")
LABELS: tuple[ObjectLabel, ...] = (*CLASSES, "unknown")
BACKGROUND = CLASSES.index("background")
UNKNOWN = LABELS.index("unknown")
"""Index of the label for an object that the classifier is not sure of: an obstacle of no known class."""
LARGE_VEHICLE = CLASSES.index("large_vehicle")
VEHICLES = (CLASSES.index("car"), LARGE_VEHICLE)
