"""The access rules as data: what each kind of neighbour may say, made from site and topics table."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import zenoh
from typer.testing import CliRunner

from common.bus.session import build, nested_settings
from common.config import ConfigError, ZenohConfig
from common.host.site import HostConfig, Ros2Config, Site, TlsConfig
from common.security.names import Name, Names
from common.security.router_config import router_config, with_certificate
from common.security.rules import access_rules, spoken_keys
from common.topics import DATA_TOPICS
from spotter_tools.cli.__main__ import app


@pytest.fixture
def names() -> Names:
    hosts = {host: Name(kind="host") for host in ("pi0", "jetson0", "infra0")}
    return Names(names={**hosts, "lap": Name(kind="laptop"), "old": Name(kind="laptop", revoked=("old",))})


def spoken_by(section: dict[str, Any], subject: str) -> set[str]:
    """Keys that a subject may put, according to the rules."""
    policy = next(policy for policy in section["policies"] if policy["subjects"] == [subject])
    rules = [rule for rule in section["rules"] if rule["id"] in policy["rules"]]
    return {k for r in rules if "put" in r["messages"] and r["flows"] == ["ingress"] for k in r["key_exprs"]}


def test_every_topic_of_the_table_may_be_spoken_by_its_host_and_by_nobody_else(names: Names) -> None:
    site = Site()
    section = access_rules(site, "jetson0", names)
    assert section["default_permission"] == "deny"
    for topic in DATA_TOPICS:
        host = site.host_of(topic.service)
        if host is None:
            continue
        key = f"spotter/{topic.key(host)}"
        speakers = {"local": "jetson0", "pi0": "pi0", "infra0": "infra0"}
        for subject, whose in speakers.items():
            assert (key in spoken_by(section, subject)) == (whose == host), (key, subject)
    assert spoken_by(section, "laptop lap") == {"spotter/lap/recorder/status"}


def test_a_host_without_services_may_say_nothing_of_its_own(names: Names) -> None:
    """It passes on which laptops record, as every host does."""
    site = Site(hosts={**Site().hosts, "pi0": HostConfig(address="10.0.0.2")})
    assert spoken_keys(site, "pi0") == []
    assert spoken_by(access_rules(site, "jetson0", names), "pi0") == {"spotter/lap/recorder/status"}
    nobody = Names(names={name: entry for name, entry in names.names.items() if entry.kind == "host"})
    assert spoken_by(access_rules(site, "jetson0", nobody), "pi0") == set()


def test_each_laptop_may_say_that_it_records_and_nothing_else(names: Names) -> None:
    names = names.with_name("second", Name(kind="laptop", generation=2))
    section = access_rules(Site(), "jetson0", names)
    for laptop in ("lap", "second"):
        assert spoken_by(section, f"laptop {laptop}") == {f"spotter/{laptop}/recorder/status"}
    common_names = {s["id"]: s.get("cert_common_names") for s in section["subjects"]}
    assert common_names["laptop second"] == ["second.2"]
    assert "laptop old" not in common_names


def test_ros_passes_between_programs_of_a_host_in_the_domains_of_the_site_and_nowhere_else(names: Names) -> None:
    section = access_rules(Site(ros2=Ros2Config(domains=(0, 7))), "jetson0", names)
    ros = {"0/**", "7/**", "@ros2_lv/0/**", "@ros2_lv/7/**"}
    assert spoken_by(section, "local") >= ros
    for subject in ("pi0", "infra0", "laptop lap"):
        assert not any(not key.startswith("spotter/") for key in spoken_by(section, subject))
    assert spoken_by(access_rules(Site(), "jetson0", names), "local").isdisjoint(ros)


def test_a_revoked_name_is_in_no_list(names: Names) -> None:
    common_names = {
        name
        for subject in access_rules(Site(), "jetson0", names)["subjects"]
        for name in subject.get("cert_common_names", [])
    }
    assert common_names == {"pi0", "infra0", "lap"}


def test_shadow_keys_stay_on_their_host(names: Names) -> None:
    section = access_rules(Site(), "jetson0", names)
    assert any(key.startswith("spotter/shadow/jetson0/") for key in spoken_by(section, "local"))
    leaving = [r for r in section["rules"] if r["flows"] == ["egress"] and r["id"] != "local hears everything"]
    assert not any("shadow" in key for rule in leaving for key in rule["key_exprs"])


@pytest.mark.parametrize("host", ["pi0", "jetson0", "infra0"])
def test_zenoh_takes_the_configuration(keys: Path, host: str) -> None:
    config = router_config(Site(), host, keys)
    build(config)
    assert nested_settings(config)["transport"]["link"]["tls"]["enable_mtls"] is True
    assert len(config.connect) == list(Site().hosts).index(host)  # one link to each earlier host


def test_what_show_prints_is_a_file_for_zenohd_wherever_it_runs(
    keys: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (keys.parent / "site.toml").write_text("[hosts.pi0]\n[hosts.jetson0]\nport = 7449\nlocal_port = 7450\n")
    monkeypatch.chdir(keys.parent)
    shown = CliRunner().invoke(app, ["router", "--host", "jetson0", "--site", "site.toml", "--show"])
    assert shown.exit_code == 0, shown.output
    (tmp_path / "router.json5").write_text(shown.stdout)
    read = zenoh.Config.from_file(str(tmp_path / "router.json5"))
    assert read.get_json("mode") == '"router"'
    assert json.loads(read.get_json("access_control"))["default_permission"] == "deny"
    tls = json.loads(read.get_json("transport/link/tls"))
    assert Path(tls["listen_private_key"]) == keys / "jetson0.key"
    assert Path(tls["root_ca_certificate"]).is_absolute()


def test_the_open_mode_has_neither_certificates_nor_rules(tmp_path: Path) -> None:
    config = router_config(Site(tls=TlsConfig(enabled=False)), "jetson0", tmp_path)
    assert all(endpoint.startswith("tcp/") for endpoint in (*config.listen, *config.connect))
    assert "access_control" not in config.extra


def test_a_missing_certificate_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"make it with `spotter keys`"):
        with_certificate(ZenohConfig(), tmp_path, "pi0")
