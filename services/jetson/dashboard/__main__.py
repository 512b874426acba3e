"""Dashboard service: the newest of every topic -> one web page."""

from __future__ import annotations

import logging

import uvicorn

from common.bus.runtime import Service
from common.bus.service_app import service_app
from common.config import ConfigError
from services.jetson.dashboard.board import Board
from services.jetson.dashboard.config import DashboardConfig
from services.jetson.dashboard.protocol import impatient
from services.jetson.dashboard.server import DashboardServer
from services.jetson.dashboard.source import BoardSource

log = logging.getLogger("dashboard")


class Server(uvicorn.Server):
    """uvicorn that says on the bus when it really listens."""

    def __init__(self, config: uvicorn.Config, service: Service) -> None:
        super().__init__(config)
        self._service = service

    async def on_tick(self, counter: int) -> bool:
        """Show the watchdog that the event loop goes round."""
        self._service.report.beat()  # the watchdog's proof that the event loop goes round
        return await super().on_tick(counter)

    async def startup(self, sockets: list | None = None) -> None:
        """Listen; a port that is taken is a wrong configuration."""
        try:
            await super().startup(sockets)
        except SystemExit:
            raise ConfigError(
                f"[server] port = {self.config.port}: cannot listen on {self.config.host}; "
                "is it taken, or is [server] address none of this host?"
            ) from None
        if self.started:
            self._service.report.state("online")
            host = f"[{self.config.host}]" if ":" in self.config.host else self.config.host
            log.info("http://%s:%d", host, self.config.port)


def run(config: DashboardConfig) -> bool:
    """Serve the page and keep it up to date until the process ends; False if not closed cleanly."""
    board = Board()
    with Service("dashboard", config) as service, BoardSource(service, board, config) as source:
        app = DashboardServer(config, board, source).app()
        settings = uvicorn.Config(
            app,
            host=config.server.address,
            port=config.server.port,
            log_level="warning",
            lifespan="off",
            http=impatient(config.server.request_within_s),
            ws="websockets-sansio",
            ws_max_size=65536,
            timeout_graceful_shutdown=1,
        )
        Server(settings, service).run()
    return service.closed_cleanly


app = service_app("dashboard", DashboardConfig, run, __doc__)


def main() -> None:
    """The console command ``spotter-dashboard``."""
    app()


if __name__ == "__main__":
    main()
