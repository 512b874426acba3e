"""site.toml: the default, the shipped file, and every way to get it wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from common.config import ConfigError, load
from common.geodesy import MapOrigin
from common.host.process_plan import children, plan_of, sensor_host_settings
from common.host.site import HostConfig, ServicePlace, Site, keys_folder, load_site
from common.topics import SERVICES
from services.jetson.dashboard.config import DashboardConfig
from services.jetson.fusion.config import FusionConfig

SHIPPED = Path(__file__).parents[2] / "compose" / "site.toml"


def written(folder: Path, text: str) -> Path:
    path = folder / "site.toml"
    path.write_text(text)
    return path


def test_the_default_runs_every_service_where_the_topics_table_says() -> None:
    site = Site()
    assert {(row.name, host) for host in site.hosts for row in site.rows(host)} == {
        (row.name, row.host) for row in SERVICES
    }
    assert site.tls.enabled


def test_the_shipped_file_is_the_default() -> None:
    assert load_site(SHIPPED) == Site()


def test_a_host_with_one_service_takes_it_from_the_file(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        """
        namespace = "yard"
        [hosts.truck]
        address = "10.0.0.2"
        [hosts.truck.services.radar]
        source = "spi:0.0"
        set = ["cfar.threshold_db=14"]
        """,
    )
    site = load_site(path)
    plan = plan_of(site, "truck", path)
    router, radar = children(site.rows("truck"), plan)
    assert router.command[1:] == ["router", "--host", "truck", "--site", str(path)]
    assert radar.command[-2:] == ["--source", "spi:0.0"]
    assert {"host=truck", "zenoh.namespace=yard", "cfar.threshold_db=14"} <= set(radar.command)
    assert site.endpoint("truck") == "tls/10.0.0.2:7448"
    assert keys_folder(site, path) == tmp_path / "keys"


def test_a_program_of_somebody_else_is_told_where_it_is(tmp_path: Path) -> None:
    place = ServicePlace(command="/opt/their-radar --fast")
    site = Site(hosts={"pi0": HostConfig(services={"radar": place})})
    _, radar = children(site.rows("pi0"), plan_of(site, "pi0", None))
    assert radar.command == ["/opt/their-radar", "--fast"]
    assert radar.environment is not None
    assert radar.environment["SPOTTER_HOST"] == "pi0"
    assert radar.environment["SPOTTER_CONNECT"] == "tcp/127.0.0.1:7447"


def test_fusion_and_dashboard_are_told_where_the_others_run() -> None:
    services = {"radar": ServicePlace(), "fusion": ServicePlace(), "dashboard": ServicePlace()}
    site = Site(hosts={"north": HostConfig(services=services)})
    assert "sensors.radar.host=north" in sensor_host_settings(site, "north", "fusion")
    config = load(FusionConfig, None, plan_of(site, "north", None).settings["fusion"] + ("host=north",))
    assert {config.host, config.ego_host, config.sensors.radar.host} == {"north"}
    assert plan_of(site, "north", None).settings["radar"] == ("ego_host=north",)
    assert sensor_host_settings(site, "north", "dashboard")[0] == "fusion_host=north"
    page = load(DashboardConfig, None, sensor_host_settings(site, "north", "dashboard"))
    assert page.server.site_hosts == ("127.0.0.1", "north")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[host.pi0]\n", "did you mean 'hosts'"),
        ("[hosts.pi0]\nadress = '1.2.3.4'\n", "did you mean 'address'"),
        ("[hosts.pi0.services.rader]\n", "no service 'rader'"),
        ("[hosts.b]\n[hosts.'Pi 0']\n", "[hosts.Pi 0] expected `str` matching"),
        ("[hosts.pi0]\nport = 7448\nlocal_port = 7448\n", "already used by"),
        ("[hosts.pi0]\nport = 70000\n", "port = 70000: expected `int` <= 65535"),
        ("[hosts.a]\n[hosts.b.services.radar]\nset = 3\n", "[hosts.b.services.radar] set = 3: expected `array`"),
        (
            "[hosts.a]\nport = 1\nlocal_port = 5\n[hosts.b]\nport = 2\nlocal_port = 5\n",
            ": [hosts.b] local_port = 5: already used",
        ),
        ("[tls]\nenable = false\n", "did you mean 'enabled'"),
    ],
    ids=[
        "section",
        "key",
        "service",
        "host name",
        "port twice",
        "port range",
        "type in a place of its own",
        "one loopback",
        "tls",
    ],
)
def test_a_wrong_file_is_refused_with_the_reason(tmp_path: Path, text: str, reason: str) -> None:
    with pytest.raises(ConfigError, match=r".") as refused:
        load_site(written(tmp_path, text))
    assert reason in str(refused.value)


def test_two_computers_may_use_the_same_ports(tmp_path: Path) -> None:
    load_site(written(tmp_path, "[hosts.a]\naddress = '10.0.0.1'\n[hosts.b]\naddress = '10.0.0.2'\n"))


def test_an_unknown_host_is_refused_with_the_known_ones() -> None:
    with pytest.raises(ConfigError, match="known: pi0, jetson0, infra0"):
        Site().host("pi1")


def test_fusion_misses_ego_and_gate_where_the_site_has_them() -> None:
    services = {name: ServicePlace() for name in ("fusion", "ego", "gate")}
    site = Site(hosts={"north": HostConfig(services=services)})
    config = load(FusionConfig, None, (*plan_of(site, "north", None).settings["fusion"], "host=north"))
    assert config.expects == ("north/ego", "north/gate")
    assert sensor_host_settings(site, "north", "gate") == ("fusion_host=north",)
    assert load(FusionConfig, None, sensor_host_settings(Site(), "jetson0", "fusion")).expects == ()


@pytest.mark.parametrize(("on_the_pole", "waited_for"), [("infra_lidar", True), ("dashboard", False)])
def test_fusion_waits_for_sensors_that_the_site_has(on_the_pole: str, waited_for: bool) -> None:
    services = {name: ServicePlace() for name in ("fusion", "lidar", "radar")}
    pole = HostConfig(address="10.0.0.9", services={on_the_pole: ServicePlace()})
    site = Site(hosts={"north": HostConfig(address="10.0.0.2", services=services), "pole": pole})
    sensors = load(FusionConfig, None, (*plan_of(site, "north", None).settings["fusion"], "host=north")).sensors
    assert (sensors.lidar.expected, sensors.radar.expected, sensors.camera.expected) == (True, True, False)
    assert sensors.infra_lidar.expected == waited_for
    assert sensors.infra_lidar.host == ("pole" if waited_for else "north")


def test_the_dashboard_is_told_where_the_map_lies() -> None:
    place = MapOrigin(latitude_deg=52.5, longitude_deg=-13.25, heading_deg=0.0)
    settings = sensor_host_settings(Site(map=place), "jetson0", "dashboard")
    assert load(DashboardConfig, None, settings).map == place
    assert load(DashboardConfig, None, sensor_host_settings(Site(), "jetson0", "dashboard")).map is None
