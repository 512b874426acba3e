"""One thing that is wrong in a way of its own becomes a finding; the doctor goes on with the others."""

from __future__ import annotations

import importlib
import importlib.util
import os
from collections.abc import Iterable
from pathlib import Path

import pytest

from common.host.site import Site
from common.host.supervisor import Child
from spotter_tools.doctor import devices, machine, services
from spotter_tools.doctor.findings import Finding


def wrong(found: Iterable[Finding]) -> list[tuple[str, str]]:
    listed = list(found)
    assert all(finding.do for finding in listed)
    return [(finding.check, finding.what) for finding in listed if finding.grade == "broken"]


def lidar(folder: Path, *lines: str) -> Child:
    """A program of the lidar's name that is a shell script."""
    program = folder / "spotter-lidar"
    program.write_text("\n".join(["#!/bin/sh", *lines]) + "\n")
    program.chmod(0o755)
    return Child("lidar", [str(program)])


def test_a_service_that_does_not_say_its_configuration_in_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(services, "SHOW_CONFIG_BUDGET_S", 0.2)
    found = services.check_services([lidar(tmp_path, "exec sleep 60")], Site())
    assert wrong(found) == [("lidar config", "`--show-config`: no answer within 0 s")]


@pytest.mark.parametrize("line", ["echo Welcome", "exit 0", "echo '[]'"])
def test_a_service_that_says_something_else_than_its_configuration(tmp_path: Path, line: str) -> None:
    found = services.check_services([lidar(tmp_path, line)], Site())
    assert wrong(found) == [("lidar config", "`--show-config` printed no configuration")]


def test_a_look_that_is_none(tmp_path: Path) -> None:
    assert wrong([services.check_look(lidar(tmp_path, "echo Welcome"))]) == [("lidar look", "no look: 'Welcome'")]


def test_a_device_of_a_group_without_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def nameless(gid: int) -> None:
        raise KeyError(f"getgrgid(): gid not found: {gid}")

    monkeypatch.setattr(devices.grp, "getgrgid", nameless)
    monkeypatch.setattr(os, "access", lambda *_: False)
    (finding,) = devices.check_device("lidar", f"serial:{tmp_path}")
    assert finding.what == f"{tmp_path} may not be used by this user"
    gid = tmp_path.stat().st_gid
    assert finding.do == f"its group {gid} has no name here; in a container: group_add {gid}"


def test_an_onnxruntime_that_lacks_its_libraries(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(_: str) -> None:
        raise ImportError("libcudnn.so.9: cannot open shared object file")

    monkeypatch.setattr(importlib.util, "find_spec", lambda _: object())
    monkeypatch.setattr(importlib, "import_module", missing)
    found = wrong(machine.check_provider())
    assert found == [("onnxruntime", "cannot be loaded: libcudnn.so.9: cannot open shared object file")]
