"""/api/tracks.geojson: what is tracked now, what is stale, and the refusal of a map that lies nowhere."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import numpy as np
import pytest

from common.geodesy import NO_ORIGIN, MapOrigin, wgs84_to_map
from common.messages import ObjectTrack, ObjectTracks
from services.jetson.dashboard import server
from services.jetson.dashboard.board import Board
from services.jetson.dashboard.config import DashboardConfig
from services.jetson.dashboard.on_earth import live_tracks

ORIGIN = MapOrigin(latitude_deg=-33.9, longitude_deg=151.2, altitude_m=20.0, heading_deg=45.0)


def tracks(x_m: float, **more: Any) -> ObjectTracks:
    track = ObjectTrack(
        track_id=3, label="cyclist", label_confidence=0.7, position_m=(x_m, -2.0, 0.9), velocity_mps=(0.0, 0.0, 0.0),
        covariance=[[0.01 * (i == j) for j in range(6)] for i in range(6)], size_m=(1.8, 0.6, 1.7), yaw_rad=0.0,
        age_s=2.0, score=0.8, state="confirmed", points=40,
    )  # fmt: skip
    return ObjectTracks(stamp_ns=5, tracks=[track], frame_id="map", **more)


def test_each_track_is_a_point_where_it_is() -> None:
    (feature,) = live_tracks([("infra0/infra_lidar/tracks", tracks(10.0), 0.1)], ORIGIN)["features"]
    longitude, latitude, height = feature["geometry"]["coordinates"]
    back = wgs84_to_map(ORIGIN, np.array([[latitude, longitude, height]]))[0]
    np.testing.assert_allclose(back, [10.0, -2.0, 0.9], atol=2e-3)
    assert feature["properties"]["course_deg"] is None
    assert feature["properties"]["heading_deg"] == 45.0
    assert feature["properties"]["sigma_m"] == pytest.approx(0.02**0.5, abs=1e-3)


@pytest.mark.parametrize(
    ("age_s", "more", "state", "count"),
    [
        (0.1, {}, "online", 1),
        (0.1, {"state": "degraded", "reason": "rain"}, "degraded", 1),
        (0.6, {}, "stale", 0),
        (0.1, {"frame_id": "lidar"}, "in the frame lidar, not map", 0),
    ],
)
def test_what_is_not_used_is_said(age_s: float, more: dict[str, str], state: str, count: int) -> None:
    message = tracks(10.0)
    for name, value in more.items():
        setattr(message, name, value)
    document = live_tracks([("infra0/infra_lidar/tracks", message, age_s)], ORIGIN)
    assert (document["hosts"]["infra0"]["state"], len(document["features"])) == (state, count)


def ask(app: Any, path: str) -> tuple[int, dict[str, str], bytes]:
    """One GET through the ASGI application, as its server would hand it over."""
    sent: list[dict[str, Any]] = []
    scope = {
        "type": "http", "asgi": {"version": "3.0"}, "http_version": "1.1", "method": "GET", "scheme": "http",
        "path": path, "raw_path": path.encode(), "root_path": "", "query_string": b"",
        "headers": [(b"host", b"127.0.0.1")], "client": ("127.0.0.1", 1), "server": ("127.0.0.1", 8080),
    }  # fmt: skip

    async def receive() -> dict[str, Any]:
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(message: dict[str, Any]) -> None:
        sent.append(message)

    asyncio.run(app(scope, receive, send))
    headers = {name.decode(): value.decode() for name, value in sent[0]["headers"]}
    return sent[0]["status"], headers, b"".join(one.get("body", b"") for one in sent[1:])


@pytest.mark.parametrize("origin", [None, ORIGIN])
def test_over_http(origin: MapOrigin | None, monkeypatch: pytest.MonkeyPatch) -> None:
    board = Board()
    monkeypatch.setattr(server, "monotonic_s", lambda: 100.1)
    board.put("infra0/infra_lidar/tracks", tracks(10.0, source_kind="simulated"), 100.0)
    app = server.DashboardServer(DashboardConfig(map=origin), board, None).app()  # type: ignore[arg-type]
    status, headers, body = ask(app, "/api/tracks.geojson")
    document = json.loads(body)
    if origin is None:
        assert (status, document) == (409, {"error": NO_ORIGIN})
        return
    assert (status, headers["content-type"]) == (200, "application/geo+json")
    assert [feature["id"] for feature in document["features"]] == ["infra0/3"]
    assert document["hosts"]["infra0"]["source_kind"] == "simulated"
