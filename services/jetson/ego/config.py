"""Configuration of the vehicle's own motion. Every default is the one written down in ``ego.toml``."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from common.config import ServiceConfig


class EgoConfig(ServiceConfig, frozen=True, kw_only=True):
    """``services/jetson/ego``."""

    host: Annotated[str, Meta(pattern=r"^[a-z0-9_]+$")] = "jetson0"
    rate_hz: Annotated[float, Meta(ge=1.0, le=200.0)] = 20.0
    has_pose: bool = True  # publish where the vehicle is in the map, not only how it moves
