"""The compose files: they parse, name services that exist, and let nobody have more than it needs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from common.hosts import plan_of
from common.site import load_site
from common.topics import SERVICES

yaml = pytest.importorskip("yaml", reason="PyYAML is not installed")
COMPOSE = Path(__file__).parents[2] / "compose"
HOSTS = {"pi.yml": "pi0", "jetson.yml": "jetson0", "infra.yml": "infra0"}


def services(name: str) -> dict[str, dict[str, Any]]:
    """The services of a file, with what they extend laid under them."""
    found: dict[str, dict[str, Any]] = yaml.safe_load((COMPOSE / name).read_text())["services"]
    for service in found.values():
        extended = service.pop("extends", None)
        if extended:
            base = yaml.safe_load((COMPOSE / extended["file"]).read_text())["services"][extended["service"]]
            service.update({**base, **service})
    return found


@pytest.mark.parametrize(("name", "host"), HOSTS.items())
def test_a_host_runs_its_services_and_a_router(name: str, host: str) -> None:
    expected = {row.name for row in SERVICES if row.host == host} | {"router", "blackbox"}
    assert set(services(name)) == expected
    for service, content in services(name).items():
        if service != "router":
            assert content["command"][-2:] == ["--only", service]
        assert content.get("profiles", []) == (["blackbox"] if service == "blackbox" else [])


@pytest.mark.parametrize("name", [*HOSTS, "router.yml", "demo.yml"])
def test_every_container_is_confined(name: str) -> None:
    for service, content in services(name).items():
        if service == "keys":  # a one-shot that writes the certificates
            continue
        assert content["read_only"] is True, service
        assert content["cap_drop"] == ["ALL"], service
        assert content["security_opt"] == ["no-new-privileges:true"], service
        assert {"mem_limit", "pids_limit"} <= set(content), service
        assert content["restart"] == "unless-stopped", service
        assert "privileged" not in content


def test_the_official_router_is_pinned_to_the_version_of_the_library() -> None:
    pinned = re.search(r"^eclipse-zenoh==([\d.]+)", (COMPOSE.parent / "constraints.txt").read_text(), re.MULTILINE)
    assert pinned is not None
    assert services("pi.yml")["router"]["image"] == f"docker.io/eclipse/zenoh:{pinned[1]}"


def test_the_demo_has_tls_and_a_dashboard_with_a_token(monkeypatch: pytest.MonkeyPatch) -> None:
    path = COMPOSE / "site.containers.toml"
    site = load_site(path)
    assert site.tls.enabled
    assert set(services("demo.yml")) == {"keys", *site.hosts}
    assert all("blackbox" in host.services for host in site.hosts.values())
    monkeypatch.setenv("SPOTTER_DASHBOARD_TOKEN", "sesame")
    assert "server.token=sesame" in plan_of(site, "jetson0", path).settings["dashboard"]


def test_the_image_is_built_from_what_the_files_ask_for() -> None:
    dockerfile = (COMPOSE / "Dockerfile").read_text()
    assert "\nUSER spotter\n" in dockerfile
    assert "HEALTHCHECK" in dockerfile
    known = set(re.findall(r"^ARG (\w+)", dockerfile, re.MULTILINE))
    for name in (*HOSTS, "laptop.yml", "router.yml", "demo.yml"):
        for content in services(name).values():
            assert set(content.get("build", {}).get("args", {})) <= known
