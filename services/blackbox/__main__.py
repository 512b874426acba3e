"""Blackbox service: the last seconds of this host -> a capsule on disk when something happens."""

from __future__ import annotations

import contextlib
import importlib.metadata
import logging
import queue
from pathlib import Path

from common.clock import utc_ns
from common.config import config_hash
from common.launch import service_app
from common.recording.services import who_speaks
from common.runtime import Service
from services.blackbox.capsule import keep_newest, write_capsule
from services.blackbox.clock import FusionClock
from services.blackbox.config import BlackboxConfig
from services.blackbox.pipeline import BlackboxPipeline
from services.blackbox.server import CapsuleServer
from services.blackbox.source import BusTap

log = logging.getLogger("blackbox")


def run(config: BlackboxConfig) -> bool:
    pipeline, folder = BlackboxPipeline(config), Path(config.folder)
    about = {"spotter": {"version": importlib.metadata.version("spotter"), "config_hash": config_hash(config)}}
    with Service("blackbox", config) as service:
        server, clock = CapsuleServer(service, folder), FusionClock(service, config.fusion_host)
        service.report.state("online")
        for kept in BusTap(service, config):
            service.report.beat()  # it publishes nothing: going round is all the proof of life there is
            now_ns = utc_ns()
            with contextlib.suppress(queue.Empty):
                pipeline.save(now_ns, server.wishes.get_nowait())
            saved = pipeline.process(now_ns, kept)
            if saved is not None:
                spoke = about | who_speaks(service.session, config.host)
                path = write_capsule(folder, config.host, saved.incident, saved.kept, spoke, clock.now())
                keep_newest(folder, config.keep_incidents)
                service.report.count("incidents")
                log.info("%s: %s", path, saved.incident.why)
    return service.closed_cleanly


app = service_app("blackbox", BlackboxConfig, run, __doc__)


def main() -> None:
    app()


if __name__ == "__main__":
    main()
