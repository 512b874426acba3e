"""The web server: one page, its files, a websocket that pushes snapshots, and the newest camera picture.

A client says what it looks at and how often it wants it; each client has its own pace, and a slow one skips.
"""

from __future__ import annotations

import asyncio
import ipaddress
import json
import secrets
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.base import BaseHTTPMiddleware
from starlette.requests import HTTPConnection, Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from common.clock import monotonic_s, utc_ns
from common.geodesy import NO_ORIGIN
from common.topics import INFRA_TRACKS
from services.jetson.dashboard.board import Board
from services.jetson.dashboard.config import DashboardConfig
from services.jetson.dashboard.on_earth import live_tracks
from services.jetson.dashboard.source import BoardSource

STATIC = Path(__file__).parent / "static"
COOKIE = "spotter_token"
POLICY = (
    "default-src 'self'; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; connect-src 'self' ws: wss:; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)


@dataclass
class Wish:
    """What one client asked for."""

    rate_hz: float = 5.0
    products: frozenset[str] = frozenset({"*"})


def parse_wish(text: str, max_rate_hz: float) -> Wish:
    """A client's JSON ``{"rate_hz": 5, "products": ["radar/tracks"]}``; nonsense becomes the default."""
    try:
        asked = json.loads(text)
        rate_hz = float(asked.get("rate_hz", 5.0))
        products = frozenset(str(name) for name in asked.get("products", ["*"])[:50])
    except (ValueError, TypeError, AttributeError, KeyError, OverflowError, RecursionError):
        return Wish()
    if not rate_hz > 0:
        rate_hz = 5.0
    return Wish(min(max(rate_hz, 0.1), max_rate_hz), products)


class DashboardServer:
    """The ASGI application around a board."""

    def __init__(self, config: DashboardConfig, board: Board, source: BoardSource) -> None:
        self._config = config
        self._board = board
        self._source = source
        self._clients = 0

    def app(self) -> Starlette:
        """The pages, the API and the WebSocket behind the guard."""
        return Starlette(
            routes=[
                Route("/", self._page),
                Route("/api/snapshot", self._snapshot),
                Route("/api/image/{host}", self._image),
                Route("/api/tracks.geojson", self._tracks),
                WebSocketRoute("/ws", self._socket),
                Mount("/static", StaticFiles(directory=STATIC)),
            ],
            middleware=[Middleware(BaseHTTPMiddleware, dispatch=self._guard)],
        )

    async def _guard(self, request: Request, follow: Callable[[Request], Awaitable[Response]]) -> Response:
        """The token, if one is set, and headers that keep everything on this host."""
        if not self._served_under(request):
            return PlainTextResponse("Not served under this name: add it to [server] allowed_hosts.\n", 421)
        if not self._allowed(request):
            return PlainTextResponse("This dashboard asks for a token: open it as /?token=...\n", 401)
        response = await follow(request)
        response.headers["Content-Security-Policy"] = POLICY
        response.headers["X-Content-Type-Options"] = "nosniff"
        response.headers["Referrer-Policy"] = "no-referrer"
        response.headers["Cache-Control"] = "no-store"
        given = request.query_params.get("token")
        if given and self._config.server.token:
            response.set_cookie(COOKIE, given, httponly=True, samesite="strict")
        return response

    def _served_under(self, connection: HTTPConnection) -> bool:
        """Whether the name asked for is ours.

        A page of another site can give its own name our address (DNS rebinding) and would then be of the same origin
        as ours. It cannot do so with an address instead of a name, so every IP address is allowed.
        """
        server = self._config.server
        try:
            name = urlsplit(f"//{connection.headers.get('host', '')}").hostname or ""
        except ValueError:  # brackets that are not closed
            return False
        return name in ("localhost", server.address, *server.allowed_hosts, *server.site_hosts) or _is_address(name)

    def _allowed(self, connection: HTTPConnection) -> bool:
        token = self._config.server.token
        given = connection.query_params.get("token") or connection.cookies.get(COOKIE, "")
        return not token or secrets.compare_digest(given.encode(), token.encode())

    async def _page(self, request: Request) -> Response:
        return FileResponse(STATIC / "index.html")

    async def _snapshot(self, request: Request) -> Response:
        return Response(self._board.snapshot(monotonic_s(), utc_ns(), {"*"}), media_type="application/json")

    async def _image(self, request: Request) -> Response:
        stamp = request.query_params.get("stamp", "")
        stamp_ns = int(stamp) if stamp.isdecimal() and len(stamp) < 20 else None
        data = self._board.image(f"{request.path_params['host']}/camera/image", stamp_ns)
        if data is None or (stamp and stamp_ns is None):
            return JSONResponse({"error": "no picture of this stamp" if stamp else "no picture yet"}, 404)
        return Response(data, media_type="image/jpeg")

    async def _tracks(self, request: Request) -> Response:
        """What the roadside lidars track now, on the Earth; 409 where nobody has said where the map lies."""
        if self._config.map is None:
            return JSONResponse({"error": NO_ORIGIN}, 409)
        document = live_tracks(self._board.newest(f"/{INFRA_TRACKS.name}", monotonic_s()), self._config.map)
        return JSONResponse(document, media_type="application/geo+json")

    async def _socket(self, socket: WebSocket) -> None:
        if not self._served_under(socket) or not self._allowed(socket) or not self._same_origin(socket):
            await socket.close(1008, "token")
            return
        if self._clients >= self._config.server.max_clients:
            await socket.close(1013, "too many clients")
            return
        await socket.accept()
        self._clients += 1
        wish = Wish()
        listener = asyncio.create_task(self._listen(socket, wish))
        try:
            await self._push(socket, wish, listener)
        except (WebSocketDisconnect, RuntimeError):
            pass  # the client went away in the middle of a message
        finally:
            self._clients -= 1
            listener.cancel()
            self._look(wish.products, -1)

    @staticmethod
    def _same_origin(socket: WebSocket) -> bool:
        """A page of another site must not read ours through its visitor's browser."""
        origin = socket.headers.get("origin")
        return origin is None or origin.split("://", 1)[-1] == socket.headers.get("host")

    async def _listen(self, socket: WebSocket, wish: Wish) -> None:
        """Keep the client's wish up to date until it goes away."""
        try:
            while True:
                new = parse_wish(await socket.receive_text(), self._config.server.max_rate_hz)
                self._look(new.products, +1)
                self._look(wish.products, -1)
                wish.rate_hz, wish.products = new.rate_hz, new.products
        except (WebSocketDisconnect, RuntimeError):
            return

    def _look(self, products: frozenset[str], viewers: int) -> None:
        for product in products:
            self._source.view(product, viewers)

    async def _push(self, socket: WebSocket, wish: Wish, listener: asyncio.Task[None]) -> None:
        while not listener.done():
            started_s = monotonic_s()
            snapshot = self._board.snapshot(started_s, utc_ns(), set(wish.products))
            await socket.send_text(snapshot.decode())  # waits while the client is slow: it then skips
            await asyncio.sleep(max(0.0, 1 / wish.rate_hz - (monotonic_s() - started_s)))


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
