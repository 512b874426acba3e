"""Multi-object tracking. Usable without the rest of the pipeline: ``MultiObjectTracker`` and ``Detections``."""

from services.infra_lidar.tracking.detections import Detections
from services.infra_lidar.tracking.tracker import MultiObjectTracker

__all__ = ["Detections", "MultiObjectTracker"]
