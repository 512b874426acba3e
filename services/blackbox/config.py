"""Configuration of the blackbox."""

from __future__ import annotations

from typing import Annotated

import msgspec

from common.config import ServiceConfig

Seconds = Annotated[float, msgspec.Meta(ge=0.5, le=600.0)]


class BlackboxConfig(ServiceConfig, frozen=True, kw_only=True):
    """``host`` is the host whose topics are kept; the verdict of ``fusion_host`` says when to save them."""

    host: Annotated[str, msgspec.Meta(pattern=r"^[a-z0-9_]+$")] = "jetson0"
    fusion_host: Annotated[str, msgspec.Meta(pattern=r"^[a-z0-9_]+$")] = "jetson0"
    folder: str = "incidents"
    before_s: Seconds = 10.0
    after_s: Seconds = 5.0
    max_mb: Annotated[float, msgspec.Meta(ge=1, le=10_000)] = 200.0  # of memory for the ring
    keep_incidents: Annotated[int, msgspec.Meta(ge=1, le=100_000)] = 200
    on_caution: bool = True
    on_health_change: bool = True
    large: bool = False  # pictures and clouds too: they are made only while somebody listens, so this costs
