"""Checks of each service of this host: its configuration, its source, the device behind it, and what that shows."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import msgspec

from common.bus.look import Look
from common.host.site import Site
from common.host.supervisor import Child
from common.source_url import source_kind
from spotter_tools.doctor.devices import check_device, check_model, check_tools
from spotter_tools.doctor.findings import Finding, broken, ok, warning
from spotter_tools.sources import EXAMPLES, MEASURES, UNKNOWN

SHOW_CONFIG_BUDGET_S = 30.0
LOOK_BUDGET_S = 60.0
LOOKS = tuple(EXAMPLES)  # services with the subcommand `look`


def check_services(processes: list[Child], site: Site, running: Collection[str] = ()) -> Iterator[Finding]:
    """Every service reads its configuration, has a source, and its sensor delivers data.

    A device whose service is among ``running`` is left to it: two readers of one sensor take each other's bytes.
    """
    for child in processes:
        if child.name == "router":
            continue
        if shutil.which(child.command[0]) is None:
            yield broken(f"{child.name} program", f"{child.command[0]} is not installed", "install this host's extra")
            continue
        if not Path(child.command[0]).name.startswith("spotter-"):
            yield ok(f"{child.name} config", f"{child.command[0]} is not ours: not checked")
            continue
        yield from _check_service(child, site, child.name in running)


def _check_service(child: Child, site: Site, is_running: bool) -> Iterator[Finding]:
    config = _configuration(child)
    if isinstance(config, Finding):
        yield config
        return
    source = str(config.get("source", ""))
    yield ok(f"{child.name} config", "its configuration can be read")
    if child.name == "gate":
        yield from check_outputs(config.get("outputs", []))
    if child.name not in MEASURES:
        return
    yield check_source(child.name, source, site)
    if not source or source_kind(source) == "simulated" or child.name not in LOOKS:
        return
    command = tuple(config.get("capture", {}).get(f"{source.partition(':')[0]}_command", ()))
    found = []
    for one in source.split(" + "):  # the vehicle's motion may come from several devices
        found += [*check_device(child.name, one, command), *check_tools(child.name, one, command)]
    found += check_model(child.name, str(config.get("detector", {}).get("model", "")))
    yield from found
    if is_running:
        yield ok(f"{child.name} look", "its service runs and has the device; what it says is below")
    elif not any(finding.grade == "broken" for finding in found):
        yield check_look(child)


def _configuration(child: Child) -> dict[str, Any] | Finding:
    """The effective configuration of the service, or the error."""
    check = f"{child.name} config"
    try:
        shown = subprocess.run(
            [*child.command, "--show-config"], capture_output=True, text=True, timeout=SHOW_CONFIG_BUDGET_S, check=False
        )
    except subprocess.TimeoutExpired:
        late = f"`--show-config`: no answer within {SHOW_CONFIG_BUDGET_S:.0f} s"
        return broken(check, late, "is this machine overloaded, or its disk slow?")
    if shown.returncode:
        error = (shown.stderr.strip().splitlines() or ["no message"])[-1].removeprefix("spotter: ")
        return broken(check, error, "correct the named key; the README of the service lists them")
    try:
        return msgspec.json.decode(shown.stdout, type=dict[str, Any])
    except msgspec.DecodeError:
        return broken(check, "`--show-config` printed no configuration", f"is {child.command[0]} the service?")


def check_outputs(outputs: list[str]) -> Iterator[Finding]:
    """The gate has an actuator, and its device and library are present."""
    if not outputs:
        do = 'outputs = ["serial:/dev/ttyACM0"] in gate.toml'
        yield warning("gate outputs", "none: nothing acts on the permission", do)
    for output in outputs:
        yield from check_device("gate", output)
        yield from check_tools("gate", output)


def check_source(service: str, source: str, site: Site) -> Finding:
    """There is one, and it is live where the site is."""
    check, kind = f"{service} source", source_kind(source)
    if not source:
        do = f'source = "{EXAMPLES.get(service, UNKNOWN)}" in site.toml, or spotter setup'
        return broken(check, "none: nothing would be measured", do)
    if kind == "live":
        return ok(check, source)
    text = f"{source} is {kind.upper()}: it measures nothing here and now"
    if site.accept_simulated:
        return warning(check, text, "fine for trials; a vehicle needs the device")
    return broken(check, text, "give the device, or accept_simulated = true at the top of site.toml for trials")


def check_look(child: Child) -> Finding:
    """The service's own program opens its own source for a second."""
    check = f"{child.name} look"
    try:
        looked = subprocess.run(
            [*child.command, "look", "--json"], capture_output=True, text=True, timeout=LOOK_BUDGET_S, check=False
        )
    except subprocess.TimeoutExpired:
        return broken(check, f"no answer within {LOOK_BUDGET_S:.0f} s", "does opening the device hang? Replug it")
    line = (looked.stdout.strip().splitlines() or [""])[-1]
    if not line:
        error = (looked.stderr.strip().splitlines() or ["no message"])[-1].removeprefix("spotter: ")
        return broken(check, error, "correct what the message names")
    try:
        look = msgspec.json.decode(line, type=Look)
    except msgspec.DecodeError:
        return broken(check, f"no look: {line!r}", f"is {child.command[0]} the service?")
    return ok(check, look.what) if look.sees else broken(check, look.what, look.do or "see the reason")
