"""`spotter setup HOST`: find the sensors of this host, show what each sees, write the site file."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from common.config import ConfigError
from common.host.process_plan import Plan, service_child, services_of
from common.host.site import load_site
from common.topics import ServiceRow
from spotter_tools.cli.connect import AsJson
from spotter_tools.cli.fail import fail
from spotter_tools.doctor.findings import Finding
from spotter_tools.doctor.services import check_look
from spotter_tools.setup.candidates import CANDIDATES, own_address
from spotter_tools.setup.site_text import NOT_FITTED, Entry, completed

NEW_FILE = "# Written by `spotter setup`; compose/site.toml names every key\n"


class Sensor(NamedTuple):
    """A service with a sensor, and the settings with which it will run."""

    row: ServiceRow
    settings: tuple[str, ...]


def setup(
    host: Annotated[str, typer.Argument(help="The role of this machine: pi0, jetson0 or infra0.")],
    site_file: Annotated[
        Path, typer.Option("--site", envvar="SPOTTER_SITE", help="Written, or completed if it is there.")
    ] = Path("site.toml"),
    yes: Annotated[
        bool, typer.Option("--yes", "-y", help="Ask nothing: the first source that shows something.")
    ] = False,
    given: Annotated[
        list[str] | None, typer.Option("--source", help="SERVICE=SOURCE to look at first, e.g. camera=csi:1.")
    ] = None,
    model: Annotated[
        Path | None,
        typer.Option("--model", help="The camera's network, an ONNX file; without it the one beside the site."),
    ] = None,
    address: Annotated[str, typer.Option(help="What other hosts dial; without it the address in this network.")] = "",
    open_mode: Annotated[
        bool, typer.Option("--open", help="Without TLS: anyone with access to a port may publish. For the bench only.")
    ] = False,
    dev: Annotated[Path, typer.Option("--dev", help="Where devices are looked for.")] = Path("/dev"),
    as_json: AsJson = False,
) -> None:
    """Detect the sensors of this host, show what each of them sees, and write their sources into the site file."""
    try:
        rows = services_of(host)
        wanted = _given(given or [], rows)
        settings = _settings(site_file, host, rows, model)
        chosen = {
            row.name: _choose(Sensor(row, settings[row.name]), wanted.get(row.name, []), dev, yes)
            for row in rows
            if row.name in CANDIDATES
        }
        entry = Entry(host, address or own_address(), chosen, settings)
        text = completed(_text_of(site_file), entry, [row.name for row in rows], open_mode=open_mode)
        _write(site_file, text)
    except ConfigError as error:
        fail(str(error), code=2)
    missing = [name for name, source in chosen.items() if not source]
    if as_json:
        print(json.dumps({"file": str(site_file), "sources": chosen, "missing": missing}))
    else:
        _print_next_steps(host, site_file, missing, open_mode)
    raise SystemExit(1 if missing else 0)


def _given(texts: list[str], rows: list[ServiceRow]) -> dict[str, list[str]]:
    sources: dict[str, list[str]] = {}
    for text in texts:
        name, equals, source = text.partition("=")
        if not equals or name not in {row.name for row in rows} & CANDIDATES.keys():
            known = ", ".join(row.name for row in rows if row.name in CANDIDATES)
            raise ConfigError(f"--source {text!r}: expected SERVICE=SOURCE; services with a sensor here: {known}")
        sources.setdefault(name, []).append(source)
    return sources


def _settings(file: Path, host: str, rows: list[ServiceRow], model: Path | None) -> dict[str, tuple[str, ...]]:
    """The settings of each service: those that the file has, and the camera's network."""
    known = load_site(file).hosts.get(host) if file.exists() else None
    settings = {row.name: known.services[row.name].set if known and row.name in known.services else () for row in rows}
    if model is None and not any(one.startswith("detector.model=") for one in settings.get("camera", ())):
        beside = sorted(file.absolute().parent.glob("*.onnx"))
        model = beside[0] if len(beside) == 1 else None
    if model is not None and "camera" in settings:
        if not model.is_file():
            raise ConfigError(f"--model {model}: no such file")
        others = tuple(one for one in settings["camera"] if not one.startswith("detector.model="))
        settings["camera"] = (*others, f"detector.model={model.absolute()}")
    return settings


def _choose(sensor: Sensor, first: list[str], dev: Path, yes: bool) -> str:
    """The source, ``NOT_FITTED`` if the user says so, or empty while there is none: then the host does not start.

    Only sources that have just delivered data are offered.
    """
    _say(f"\n{sensor.row.name}: looking for a sensor")
    sees = []
    for source in dict.fromkeys([*first, *CANDIDATES[sensor.row.name](dev)]):
        found = _look(sensor, source)
        _say(f"  {'sees   ' if found.grade == 'ok' else 'nothing'} {source}: {found.what}")
        sees += [source] if found.grade == "ok" else []
    if not sees:
        _say("  no sensor that speaks")
    if yes:
        return sees[0] if sees else ""
    return _ask(sensor, sees)


def _look(sensor: Sensor, source: str) -> Finding:
    name = sensor.row.name
    return check_look(service_child(sensor.row, Plan(sources={name: source}, settings={name: sensor.settings})))


def _ask(sensor: Sensor, sees: list[str]) -> str:
    """Enter takes what is proposed; another source is looked at before it is taken. Nothing is left out by Enter."""
    if not sees:
        _say(f"  give its source, or `{NOT_FITTED}` if the vehicle has none: then nobody will expect it")
    while True:
        answer = str(
            typer.prompt(f"  source of {sensor.row.name}", default=sees[0] if sees else None, err=True)
        ).strip()
        if answer == NOT_FITTED or answer in sees:
            return answer
        found = _look(sensor, answer)
        _say(f"  {'sees   ' if found.grade == 'ok' else 'nothing'} {answer}: {found.what}")
        if found.grade == "ok" or typer.confirm("  take it all the same?", default=False, err=True):
            return answer


def _text_of(file: Path) -> str:
    return file.read_text(encoding="utf-8") if file.exists() else NEW_FILE


def _write(file: Path, text: str) -> None:
    """Read back first: what no service could read does not replace what was there."""
    draft = file.with_name(f".{file.name}.new")
    try:
        draft.write_text(text, encoding="utf-8")
        load_site(draft)
        os.replace(draft, file)
    except OSError as error:
        raise ConfigError(f"{file}: {error.strerror}") from None
    finally:
        draft.unlink(missing_ok=True)
    _say(f"\n{file}:\n" + "".join(f"  {line}\n" for line in text.splitlines()))


def _print_next_steps(host: str, file: Path, missing: list[str], open_mode: bool) -> None:
    for name in missing:
        _say(f"{name} has no source, so {host} will not start: plug it in and run this again; see docs/bring-up.md")
    keys = "" if open_mode else f"  spotter keys init --site {file} && spotter keys all --site {file}\n"
    _say(f"next:\n{keys}  spotter up {host} --site {file}\n  spotter health --watch")


def _say(text: str) -> None:
    sys.stderr.write(text + "\n")
    sys.stderr.flush()
