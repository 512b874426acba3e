"""The compose files: they parse, name services that exist, and let nobody have more than it needs."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from typing import Any

import pytest

from common.host.process_plan import plan_of
from common.host.site import load_site
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
    optional = {"blackbox", "gate"} if host == "jetson0" else {"blackbox"}
    expected = {row.name for row in SERVICES if row.host == host} | {"router", *optional}
    assert set(services(name)) == expected
    for service, content in services(name).items():
        if service != "router":
            assert content["command"][-2:] == ["--only", service]
        assert content.get("profiles", []) == ([service] if service in optional else [])


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


ALL_FILES = sorted(path.name for path in COMPOSE.glob("*.yml"))


@pytest.mark.parametrize("name", ALL_FILES)
def test_debian_12_s_docker_compose_reads_it(name: str) -> None:
    """1.29 allows these sections and no other: `name` came with the second major version."""
    sections = set(yaml.safe_load((COMPOSE / name).read_text()))
    assert {one for one in sections if not one.startswith("x-")} <= {"services", "networks", "volumes"}


def test_the_jetsons_image_has_what_its_capture_starts() -> None:
    (build,) = [content["build"] for content in services("jetson.yml").values() if "build" in content]
    packages = build["args"]["PACKAGES"].split()
    assert {"gstreamer1.0-tools", "gstreamer1.0-plugins-base", "gstreamer1.0-plugins-good"} <= set(packages)
    assert "apt-get install -y --no-install-recommends $PACKAGES" in (COMPOSE / "Dockerfile").read_text()


def test_the_file_for_csi_gives_the_camera_its_daemons_socket_and_nothing_to_others() -> None:
    added = yaml.safe_load((COMPOSE / "csi.yml").read_text())["services"]
    assert set(added) == {"camera"}
    assert added["camera"]["volumes"] == ["/tmp/argus_socket:/tmp/argus_socket"]
    assert added["camera"]["runtime"] == "nvidia"


def test_what_is_built_for_minutes_is_kept_in_a_volume() -> None:
    """TensorRT's engines and compiled kernels: the camera keeps the first below CACHE_DIRECTORY, as under systemd."""
    (cache,) = re.findall(r"CACHE_DIRECTORY=(\S+) NUMBA_CACHE_DIR=\1 ", (COMPOSE / "Dockerfile").read_text())
    for content in services("jetson.yml").values():
        if "build" in content:
            assert f"cache:{cache}" in content["volumes"]


def test_volumes_are_the_same_whatever_the_project_is_called() -> None:
    for name in (*HOSTS, "demo.yml"):
        volumes = yaml.safe_load((COMPOSE / name).read_text())["volumes"]
        project = "spotter-demo" if name == "demo.yml" else "spotter"
        assert {volume: content["name"] for volume, content in volumes.items()} == {
            volume: f"{project}_{volume}" for volume in volumes
        }


def test_the_script_that_tries_the_demo_is_valid_and_waits_for_every_host() -> None:
    script = COMPOSE / "try.sh"
    subprocess.run(["bash", "-n", str(script)], check=True)
    hosts = re.search(r"for host in ([\w ]+);", script.read_text())
    assert hosts is not None
    assert set(hosts[1].split()) == set(load_site(COMPOSE / "site.containers.toml").hosts)


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
