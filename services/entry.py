"""Where the services' commands begin: Ctrl-C while their modules are still being imported is as quiet as later on."""

from __future__ import annotations

import importlib
import os
from typing import NoReturn


def _begin(package: str) -> NoReturn:
    """Import the service and run it."""
    try:
        run = importlib.import_module(f"{package}.__main__").main
    except KeyboardInterrupt:
        os._exit(0)  # as after a Ctrl-C later on; nothing was begun that has to be cleared up
    run()
    raise SystemExit


def radar() -> NoReturn:
    """``spotter-radar``."""
    _begin("services.radar_pi")


def lidar() -> NoReturn:
    """``spotter-lidar``."""
    _begin("services.jetson.lidar")


def camera() -> NoReturn:
    """``spotter-camera``."""
    _begin("services.jetson.camera")


def fusion() -> NoReturn:
    """``spotter-fusion``."""
    _begin("services.jetson.fusion")


def dashboard() -> NoReturn:
    """``spotter-dashboard``."""
    _begin("services.jetson.dashboard")


def ego() -> NoReturn:
    """``spotter-ego``."""
    _begin("services.jetson.ego")


def gate() -> NoReturn:
    """``spotter-gate``."""
    _begin("services.jetson.gate")


def blackbox() -> NoReturn:
    """``spotter-blackbox``."""
    _begin("services.blackbox")


def infra_lidar() -> NoReturn:
    """``spotter-infra-lidar``."""
    _begin("services.infra_lidar")
