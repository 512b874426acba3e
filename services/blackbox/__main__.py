"""Blackbox service: the last seconds of this host -> a capsule on disk when something happens."""

from __future__ import annotations

import contextlib
import importlib.metadata
import logging
import queue
from pathlib import Path

from common.bus.runtime import Service
from common.bus.service_app import service_app
from common.clock import monotonic_s
from common.config import config_hash
from common.recording.services import running_services
from services.blackbox.capsule import HostClock, keep_newest, write_capsule
from services.blackbox.clock import FusionClock
from services.blackbox.config import BlackboxConfig
from services.blackbox.pipeline import BlackboxPipeline, Saved
from services.blackbox.server import CapsuleServer
from services.blackbox.source import BusTap

log = logging.getLogger("blackbox")


def run(config: BlackboxConfig) -> bool:
    """Keep the last seconds of this host until the process ends; False if not closed cleanly."""
    pipeline, folder = BlackboxPipeline(config), Path(config.folder)
    about = {"spotter": {"version": importlib.metadata.version("spotter"), "config_hash": config_hash(config)}}
    written: list[str] = []
    with Service("blackbox", config) as service:
        server, clock = CapsuleServer(service, folder), FusionClock(service, config.fusion_host)
        service.report.state("online")
        for kept in BusTap(service, config):
            service.report.beat()  # it publishes nothing: going round is all the proof of life there is
            now_s = monotonic_s()
            with contextlib.suppress(queue.Empty):
                request = server.requests.get_nowait()
                server.answer(request, pipeline.save(now_s, request.incident))
            saved = pipeline.process(now_s, kept)
            if saved is not None:
                spoke = about | running_services(service.session, config.host)
                keep(service, config, saved, spoke, clock.now(), written)
    return service.closed_cleanly


def keep(
    service: Service, config: BlackboxConfig, saved: Saved, about: dict[str, dict[str, str]], clock: HostClock,
    written: list[str],
) -> None:  # fmt: skip
    """Write the capsule, and its name to ``written``.

    A disk that takes no more costs this incident; the next is tried all the same.
    """
    folder, incident = Path(config.folder), saved.incident
    try:
        path = write_capsule(folder, config.host, incident, saved.kept, about, clock)
        written[:] = [*written, incident.name][-config.keep_incidents :]
        keep_newest(folder, config.keep_incidents, written)
    except OSError as error:
        said = f"{incident.name} was not kept: {folder}: {error.strerror or error}"
        log.error("%s (%s)", said, incident.why)
        service.report.count("incidents lost")
        service.report.state("degraded", said)
        return
    service.report.count("incidents")
    service.report.state("online")
    log.info("%s: %s", path, incident.why)


app = service_app("blackbox", BlackboxConfig, run, __doc__)


def main() -> None:
    """The console command ``spotter-blackbox``."""
    app()


if __name__ == "__main__":
    main()
