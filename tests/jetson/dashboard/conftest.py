"""A real dashboard process, a real headless Chromium driven over its debugging protocol, and services to show."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import zenoh

from common.bus.session import build
from common.config import ZenohConfig
from spotter_tools.ports import free_port

BROWSER_FILE = Path(__file__).parents[3] / "docs" / "browser.py"


def _load_browser() -> ModuleType:
    """The same few lines of DevTools Protocol as the screenshots use; they are no package."""
    spec = importlib.util.spec_from_file_location("browser", BROWSER_FILE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


_browser = _load_browser()


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    if _browser.CHROMIUM is None:
        pytest.skip("no Chromium on this machine; the server's own tests do not need one")
    browser = _browser.Browser(tmp_path_factory.mktemp("chromium"))
    yield browser
    browser.close()


class Dashboard:
    """A dashboard process."""

    def __init__(self, endpoint: str, port: int, *settings: str) -> None:
        self.url = f"http://127.0.0.1:{port}"
        self.port = port
        script = str(Path(sys.executable).with_name("spotter-dashboard"))
        command = [script, "--set", f'zenoh.connect=["{endpoint}"]', "--set", f"server.port={port}"]
        for setting in settings:
            command += ["--set", setting]
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE)

    def answers(self) -> bool:
        assert self.process.poll() is None, self.process.stderr and self.process.stderr.read()
        try:
            with urllib.request.urlopen(f"{self.url}/", timeout=2):
                return True
        except urllib.error.HTTPError:
            return True
        except OSError:
            return False

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.terminate()
            self.process.wait(10)
        if self.process.stderr:
            self.process.stderr.close()


@pytest.fixture(scope="module")
def module_router() -> Iterator[str]:
    """A router for all tests of a file."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with zenoh.open(build(ZenohConfig(mode="router", connect=(), listen=(endpoint,), namespace=""))):
        yield endpoint


@pytest.fixture(scope="module")
def start_dashboard_at(until: Callable[..., None]) -> Iterator[Callable[..., Dashboard]]:
    """``start(endpoint, *settings, port=...)``: dashboards that end with the file."""
    started: list[Dashboard] = []

    def start(endpoint: str, *settings: str, port: int | None = None) -> Dashboard:
        started.append(Dashboard(endpoint, port or free_port(), *settings))
        until(started[-1].answers, budget_s=30)
        return started[-1]

    yield start
    for dashboard in started:
        dashboard.close()
