"""Setting values in the text of a TOML file so that everything else in it, comments included, stays as it is. Pure."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from common.source_url import source_kind

NOT_FITTED = "none"


class Entry(NamedTuple):
    """What is known of a host: its address, by service the chosen source and the settings.

    A source is ``NOT_FITTED`` where the vehicle has no such sensor, and empty where it has but none was found.
    """

    host: str
    address: str
    sources: Mapping[str, str]
    settings: Mapping[str, tuple[str, ...]]


def completed(text: str, entry: Entry, services: Iterable[str], *, open_mode: bool) -> str:
    """The site file's text with this host and its services in it.

    A sensor that was not found has a section without a source: it is expected, and `spotter up` refuses to start
    without it. What the file says of it already stays.
    """
    named = [source for source in entry.sources.values() if source not in ("", NOT_FITTED)]
    if any(source_kind(source) != "live" for source in named):
        text = with_value(text, "", "accept_simulated", value=True)
    if open_mode:
        text = with_value(text, "tls", "enabled", value=False)
    text = with_value(text, f"hosts.{entry.host}", "address", entry.address)
    for name in services:
        section, source = f"hosts.{entry.host}.services.{name}", entry.sources.get(name, "")
        if source == NOT_FITTED:
            continue
        text = with_value(text, section, "source", source) if source else with_section(text, section)
        if source and entry.settings.get(name):
            text = with_value(text, section, "set", list(entry.settings[name]))
    return text


def with_value(text: str, section: str, key: str, value: str | bool | list[str]) -> str:
    """The text in which ``[section] key`` has this value; section "" is the top. Missing parts are added at the end.

    Only tables that are written as ``[a.b.c]`` headers are understood; the caller reads the result back.
    """
    literal = json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")  # TOML requires it
    line = f"{key} = {literal}"
    lines = text.splitlines()
    begin = _header(lines, section)
    if begin is None:
        gap = [""] if lines and lines[-1].strip() else []
        return "\n".join([*lines, *gap, f"[{section}]", line]) + "\n"
    end = next((i for i in range(begin, len(lines)) if lines[i].lstrip().startswith("[")), len(lines))
    for i in range(begin, end):
        if re.match(rf"\s*{re.escape(key)}\s*=", lines[i]):
            lines[i] = line + _comment(lines[i])
            return "\n".join(lines) + "\n"
    if section:  # behind what the section has
        begin = next((i + 1 for i in reversed(range(begin, end)) if lines[i].strip()), begin)
    else:  # behind the comment that the file begins with
        begin = next((i for i, one in enumerate(lines) if not one.startswith("#")), len(lines))
    return "\n".join([*lines[:begin], line, *lines[begin:]]) + "\n"


def with_section(text: str, section: str) -> str:
    """The text with this section, empty if it was not there."""
    lines = text.splitlines()
    if _header(lines, section) is not None:
        return text
    return "\n".join([*lines, f"[{section}]"]) + "\n"


def _header(lines: list[str], section: str) -> int | None:
    """The index of the first line behind the header; None where there is no such section."""
    if not section:
        return 0
    wanted = re.compile(rf"\s*\[\s*{re.escape(section)}\s*\]\s*(#.*)?$")
    return next((i + 1 for i, line in enumerate(lines) if wanted.match(line)), None)


def _comment(line: str) -> str:
    """The comment behind a value without a ``#`` of its own."""
    found = re.match(r'[^=]*=\s*(?:"[^"]*"|[^"#]*)(\s*#.*)$', line)
    return found[1] if found else ""
