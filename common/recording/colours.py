"""The colours of what viewers are shown, red, green and blue from 0 to 1: of each kind of object and of each level."""

COLOURS = {
    "car": (0.3, 0.64, 1.0),
    "large_vehicle": (0.71, 0.55, 1.0),
    "cyclist": (1.0, 0.72, 0.3),
    "pedestrian": (0.37, 0.83, 0.55),
    "unknown": (1.0, 0.48, 0.48),
    "background": (0.5, 0.55, 0.6),
    "SAFE": (0.2, 0.75, 0.4),
    "CAUTION": (1.0, 0.72, 0.1),
    "IMMINENT": (0.85, 0.1, 0.2),
}
