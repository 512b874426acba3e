"""Two vehicles and a roadside host in one site file: every service listens to its own vehicle."""

from __future__ import annotations

import textwrap
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config import ConfigError, load
from common.host.process_plan import plan_of
from common.host.site import HostConfig, ServicePlace, Site, load_site
from common.security.names import Name, Names
from common.security.rules import access_rules
from services.jetson.dashboard.config import DashboardConfig
from services.jetson.fusion.config import FusionConfig

TWO_VEHICLES = """
[hosts.pi0]
vehicle = "car0"
address = "10.0.0.1"
[hosts.pi0.services.radar]
[hosts.jetson0]
vehicle = "car0"
address = "10.0.0.2"
[hosts.jetson0.services.lidar]
[hosts.jetson0.services.camera]
[hosts.jetson0.services.fusion]
[hosts.jetson0.services.dashboard]
[hosts.pi1]
vehicle = "car1"
address = "10.0.0.3"
[hosts.pi1.services.radar]
[hosts.jetson1]
vehicle = "car1"
address = "10.0.0.4"
[hosts.jetson1.services.lidar]
[hosts.jetson1.services.camera]
[hosts.jetson1.services.fusion]
[hosts.jetson1.services.dashboard]
[hosts.infra0]
address = "10.0.0.5"
[hosts.infra0.services.infra_lidar]
"""


def site_of(folder: Path, text: str) -> Site:
    path = folder / "site.toml"
    path.write_text(text)
    return load_site(path)


def fusion_of(site: Site, host: str) -> FusionConfig:
    """The configuration with which ``spotter up HOST`` starts fusion."""
    return load(FusionConfig, None, (f"host={host}", *plan_of(site, host, None).settings["fusion"]))


@pytest.mark.parametrize("number", ["0", "1"])
def test_each_fusion_listens_to_its_own_vehicle_and_the_roadside(tmp_path: Path, number: str) -> None:
    site = site_of(tmp_path, TWO_VEHICLES)
    config = fusion_of(site, f"jetson{number}")
    sensors = config.sensors
    assert (sensors.lidar.host, sensors.radar.host, sensors.camera.host, config.ego_host) == (
        f"jetson{number}", f"pi{number}", f"jetson{number}", f"jetson{number}",
    )  # fmt: skip
    assert sensors.infra_lidar.host == "infra0"
    assert config.vehicle.name == f"car{number}"
    assert set(config.vehicle.other_hosts) == {"pi0", "jetson0", "pi1", "jetson1"} - set(config.vehicle.hosts)
    assert f"fusion_host=jetson{number}" in plan_of(site, f"jetson{number}", None).settings["dashboard"]


def test_without_vehicle_keys_all_hosts_are_the_one_vehicle_s() -> None:
    config = fusion_of(Site(), "jetson0")
    assert set(config.vehicle.hosts) == {"pi0", "jetson0", "infra0"}
    for name in ("lidar", "radar", "camera", "infra_lidar"):
        assert getattr(config.sensors, name).host == getattr(FusionConfig().sensors, name).host


def test_two_vehicles_without_vehicle_keys_are_refused(tmp_path: Path) -> None:
    text = "\n".join(line for line in TWO_VEHICLES.splitlines() if not line.startswith("vehicle"))
    with pytest.raises(ConfigError, match=r"site\.toml: \[hosts\.jetson1\.services\.lidar\].*vehicle = \"car1\""):
        site_of(tmp_path, text)


def test_a_vehicle_s_service_at_the_roadside_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"\[hosts\.infra0\] vehicle = ''.*radar.*allowed: car0, car1"):
        site_of(tmp_path, TWO_VEHICLES + "[hosts.infra0.services.radar]\n")


@pytest.mark.parametrize(
    ("setting", "pattern"),
    [
        ("sensors.lidar.host=jetson0", r"\[sensors\.lidar\] host = 'jetson0'.*vehicle 'car1'.*allowed: pi1, jetson1 "),
        ("ego_host=pi0", r"ego_host = 'pi0'.*allowed: pi1, jetson1 "),
        ("sensors.radar.host=infra0", r"\[sensors\.radar\] host = 'infra0'.*allowed: pi1, jetson1 "),
        ("sensors.infra_lidar.host=jetson0", r"host = 'jetson0'.*allowed: pi1, jetson1, infra0 "),
    ],
)
def test_a_sensor_of_another_vehicle_is_refused_at_the_start(tmp_path: Path, setting: str, pattern: str) -> None:
    text = TWO_VEHICLES.replace(
        "[hosts.jetson1.services.fusion]", f"[hosts.jetson1.services.fusion]\nset=['{setting}']"
    )
    with pytest.raises(ConfigError, match=pattern):
        fusion_of(site_of(tmp_path, text), "jetson1")


def test_the_settings_of_a_service_cannot_widen_its_vehicle(tmp_path: Path) -> None:
    text = TWO_VEHICLES.replace(
        "[hosts.jetson1.services.fusion]",
        "[hosts.jetson1.services.fusion]\nset=['vehicle.hosts=[\"jetson0\",\"jetson1\"]','sensors.lidar.host=jetson0']",
    )
    with pytest.raises(ConfigError, match="not a host of vehicle 'car1'"):
        fusion_of(site_of(tmp_path, text), "jetson1")


def test_a_file_of_the_wrong_vehicle_is_named(tmp_path: Path) -> None:
    path = tmp_path / "fusion.toml"
    path.write_text('host = "jetson1"\n[sensors.lidar]\nhost = "jetson1"\n')
    with pytest.raises(ConfigError, match=r"fusion\.toml: host = 'jetson1'.*allowed: jetson0, pi0"):
        load(FusionConfig, path)


def test_a_roadside_page_has_to_say_whose_verdict_it_shows(tmp_path: Path) -> None:
    text = TWO_VEHICLES + "[hosts.infra0.services.dashboard]\n"
    with pytest.raises(ConfigError, match="allowed: fusion_host=jetson0, fusion_host=jetson1"):
        plan_of(site_of(tmp_path, text), "infra0", None)
    site = site_of(tmp_path, text + "set = ['fusion_host=jetson1']\n")
    assert plan_of(site, "infra0", None).settings["dashboard"][-1] == "fusion_host=jetson1"


def test_the_example_of_the_page_is_a_site_with_two_vehicles(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "vehicles.md").read_text()
    example = textwrap.dedent(page.split("```toml\n")[1].split("```")[0])
    assert site_of(tmp_path, example) == site_of(tmp_path, TWO_VEHICLES)
    assert site_of(tmp_path, example).vehicles == ("car0", "car1")


names = st.sampled_from(["", "car0", "car1", "car2"])
services = st.sets(st.sampled_from(["lidar", "radar", "camera", "ego", "fusion", "infra_lidar", "dashboard"]))


@given(st.dictionaries(st.sampled_from(["a", "b", "c", "d", "e"]), st.tuples(names, services), min_size=1))
def test_no_site_lets_a_fusion_name_a_host_of_another_vehicle(drawn: dict[str, tuple[str, set[str]]]) -> None:
    """Every site file that is accepted gives each fusion hosts of its own vehicle."""
    hosts = {
        name: HostConfig(vehicle=vehicle, address=f"10.0.0.{i}", services={s: ServicePlace() for s in sorted(running)})
        for i, (name, (vehicle, running)) in enumerate(drawn.items(), 1)
    }
    try:
        site = Site(hosts=hosts)
    except ValueError:
        return
    named = {host.vehicle for host in hosts.values()} - {""}
    for host in site.hosts_with("fusion"):
        own = {name for name, one in hosts.items() if not named or one.vehicle == hosts[host].vehicle}
        roadside = {name for name, one in hosts.items() if named and not one.vehicle}
        config = fusion_of(site, host)
        sensors = config.sensors
        assert {sensors.lidar.host, sensors.radar.host, sensors.camera.host, config.ego_host} <= own
        assert sensors.infra_lidar.host in own | roadside
        assert set(config.vehicle.other_hosts) == set(hosts) - own - roadside


def test_a_page_shows_nothing_of_other_vehicles(tmp_path: Path) -> None:
    site = site_of(tmp_path, TWO_VEHICLES)
    page = load(DashboardConfig, None, plan_of(site, "jetson1", None).settings["dashboard"])
    assert (page.fusion_host, set(page.other_hosts)) == ("jetson1", {"pi0", "jetson0"})


def test_the_rules_let_no_host_speak_for_another_vehicle(tmp_path: Path) -> None:
    site = site_of(tmp_path, TWO_VEHICLES)
    names = Names(names={host: Name(kind="host") for host in site.hosts})
    for own in site.hosts:
        for rule in access_rules(site, own, names)["rules"]:
            speaker = rule["id"].removesuffix(" speaks")
            if speaker in site.hosts:
                assert {key.split("/")[1] for key in rule["key_exprs"]} == {speaker}
