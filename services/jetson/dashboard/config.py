"""Configuration of the dashboard."""

from __future__ import annotations

from typing import Annotated

import msgspec

from common.config import Section, ServiceConfig
from common.geodesy import MapOrigin


class ServerConfig(Section, frozen=True, kw_only=True):
    """Where the page is served. On any other address than loopback a token is required."""

    address: str = "127.0.0.1"
    port: Annotated[int, msgspec.Meta(ge=0, le=65535)] = 8080
    allowed_hosts: tuple[str, ...] = ()  # further names under which a browser may ask for the page
    site_hosts: tuple[str, ...] = ()  # the names in the site file; `spotter up` fills them in
    token: str = ""  # asked for as ?token=...; without one only loopback is allowed
    max_clients: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 50
    request_within_s: Annotated[float, msgspec.Meta(ge=1, le=600)] = 10.0  # then a connection without one is closed
    max_rate_hz: Annotated[float, msgspec.Meta(gt=0, le=60)] = 20.0


class DashboardConfig(ServiceConfig, frozen=True, kw_only=True):
    """``fusion_host`` says whose verdict the page shows."""

    host: Annotated[str, msgspec.Meta(pattern=r"^[a-z0-9_]+$")] = "jetson0"
    fusion_host: Annotated[str, msgspec.Meta(pattern=r"^[a-z0-9_]+$")] = "jetson0"
    other_hosts: tuple[str, ...] = ()  # of other vehicles: not shown; `spotter up` fills them in
    server: ServerConfig = ServerConfig()
    map: MapOrigin | None = None  # where the map lies on the Earth, for /api/tracks.geojson; `spotter up` fills it in

    def check(self) -> None:
        """Nobody on the network may look without a token, and the browser keeps that in a cookie, which is ASCII."""
        if not all("!" <= character <= "~" for character in self.server.token):
            raise ValueError("[server] token: expected letters, digits and signs of ASCII, without spaces")
        loopback = self.server.address in ("127.0.0.1", "::1", "localhost")
        if not loopback and not self.server.token:
            raise ValueError(
                f"[server] address = {self.server.address!r}: anybody on the network could look; "
                "set [server] token, or serve on 127.0.0.1"
            )
