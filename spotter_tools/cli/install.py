"""`spotter install HOST`: the host's role as systemd units."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Annotated

import typer

from common.config import ConfigError
from common.host.systemd import SYSUSERS, hidden, units
from spotter_tools.cli.connect import AsJson
from spotter_tools.cli.fail import fail
from spotter_tools.cli.site_option import SiteFile, read_site

UNITS, USERS = Path("/etc/systemd/system"), Path("/etc/sysusers.d/spotter.conf")


def install(
    host: Annotated[str, typer.Argument(help="A host of site.toml.")],
    site_file: SiteFile = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Print the units, write nothing.")] = False,
    to: Annotated[Path, typer.Option("--to", help="Folder for the units.")] = UNITS,
    as_json: AsJson = False,
) -> None:
    """Write hardened units for this host's router and services, and the user they run as."""
    site, _ = read_site(site_file)
    place = str((site_file or Path("/etc/spotter/site.toml")).absolute())
    program = str(Path(sys.executable).with_name("spotter").absolute())
    try:
        files = units(site, host, program, place)
    except ConfigError as error:
        fail(str(error), code=2)
    hidden = _out_of_sight(program, place)
    if hidden and to == UNITS and not dry_run:
        fail(hidden)
    if hidden:
        sys.stderr.write(f"spotter: {hidden}\n")
    if dry_run:
        shown = {str(to / name): text for name, text in files.items()}
        print(json.dumps(shown) if as_json else "\n".join(f"# {path}\n{text}" for path, text in shown.items()))
        return
    _write(files, to)
    if not as_json:
        print("\n".join(f"wrote {to / name}" for name in files))
    if to == UNITS:
        _activate()
    if as_json:
        print(json.dumps({"wrote": [str(to / name) for name in files]}))
        return
    print("next: chown -R spotter: /etc/spotter/keys && systemctl enable --now spotter.target " + " ".join(files))


def _write(files: dict[str, str], to: Path) -> None:
    try:
        to.mkdir(parents=True, exist_ok=True)
        for name, text in files.items():
            (to / name).write_text(text)
        if to == UNITS:
            USERS.write_text(SYSUSERS)
    except PermissionError as error:
        fail(f"{error.filename}: not writable by this user; run it with sudo")
    except OSError as error:
        fail(f"--to {to}: expected a folder that takes the units: {error.filename or to}: {error.strerror}")


def _out_of_sight(program: str, site_file: str) -> str:
    """What the units could not see, and where to put it; empty when they see all."""
    paths = hidden(program, site_file, sys.base_prefix)
    advice = (
        "keep site.toml in /etc/spotter, and make the environment in /opt/spotter with a Python in nobody's home "
        "(uv: UV_PYTHON_INSTALL_DIR=/opt/python)"
    )
    return f"no unit can see {', '.join(paths)} (ProtectHome, PrivateTmp): {advice}" if paths else ""


def _activate() -> None:
    for command in (["systemd-sysusers"], ["systemctl", "daemon-reload"]):
        if shutil.which(command[0]) is None:
            fail(f"{command[0]} is not here: the units are written, but this machine does not run systemd")
        subprocess.run(command, check=True)
