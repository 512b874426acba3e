"""Messages as text for people."""

from __future__ import annotations

import os
import sys
from typing import Any

import typer

from common.messages import SourceKind, SystemHealth, Verdict
from common.topics import spoken

MAX_LIST = 8
ORIGIN_WORDS: dict[SourceKind, str] = {
    "live": "LIVE", "recorded": "RECORDED DATA", "emulated": "EMULATED DEVICE", "simulated": "SIMULATED DATA",
    "unknown": "DATA OF UNKNOWN ORIGIN",
}  # fmt: skip
COLOUR_OF = {
    "SAFE": "green", "CAUTION": "yellow", "IMMINENT": "red", "NO VERDICT": "red", "BLIND": "red",
    "GREEN": "green", "AMBER": "yellow", "RED": "red",
    "online": "green", "starting": "yellow", "degraded": "yellow", "disconnected": "red", "no answer": "red",
    "recorded": "magenta", "emulated": "magenta", "simulated": "magenta", "unknown": "magenta",
}  # fmt: skip


def coloured(word: str, width: int = 0) -> str:
    """A level or state, padded to ``width``; in its colour on a terminal, plain in a file or pipe and with NO_COLOR."""
    padded = f"{word:<{width}}"
    if not sys.stdout.isatty() or "NO_COLOR" in os.environ:
        return padded
    return typer.style(padded, fg=COLOUR_OF.get(word), bold=True)


def readable(content: Any, indent: int = 2) -> str:
    """Nested builtins as short indented text; long numeric lists are cut."""
    pad = " " * indent
    if isinstance(content, dict):
        if not content:
            return f"{pad}{{}}"
        lines = []
        for key, value in content.items():
            if _is_flat(value):
                lines.append(f"{pad}{key}: {_short(value)}")
            else:
                lines.append(f"{pad}{key}:\n{readable(value, indent + 2)}")
        return "\n".join(lines)
    if isinstance(content, list):
        shown = content[:MAX_LIST]
        lines = [f"{pad}- {readable(item, indent + 2).lstrip()}" for item in shown]
        if len(content) > MAX_LIST:
            lines.append(f"{pad}... {len(content) - MAX_LIST} more")
        return "\n".join(lines)
    return f"{pad}{_short(content)}"


def origin_line(verdict: Verdict | None) -> str:
    """In capitals what a verdict that is not live rests on; empty for one that is, and while no sensor has spoken."""
    if verdict is None or verdict.source_kind == "live":
        return ""
    made = [f"{spoken(name)} {one.source_kind}" for name, one in verdict.inputs.items() if one.age_ms is not None]
    made = [text for text in made if not text.endswith(" live")]
    if not made and verdict.source_kind == "unknown":
        return ""
    return f"NOT LIVE, {ORIGIN_WORDS[verdict.source_kind]}: {', '.join(made) or 'the motion of the vehicle'}"


def verdict_line(verdict: Verdict | None, silent_s: float) -> str:
    """One line: level, permission, why; or that there is none."""
    if verdict is None:
        return f"{coloured('NO VERDICT')} for {silent_s:.1f} s: treat as STOP; is fusion running?"
    flags = [name for name in ("confirmed", "suppressed") if getattr(verdict, name)] + (
        [verdict.advisory] if verdict.advisory else []
    )
    marks = f" [{', '.join(flags)}]" if flags else ""
    face = f"{coloured('BLIND')} {verdict.level}" if verdict.blind else coloured(verdict.level)
    return f"{face} -> {verdict.permission}{marks}  {verdict.because} (rule {verdict.rule})"


def verdict_text(verdict: Verdict | None, silent_s: float) -> str:
    """``verdict_line``, under a line that says so when it is not live."""
    return "\n".join(filter(None, (origin_line(verdict), verdict_line(verdict, silent_s))))


def reason_lines(verdict: Verdict) -> list[str]:
    """What each sensor contributed to the verdict, why, and what would have to change for the level to drop."""
    lines = []
    for name, used_input in verdict.inputs.items():
        age = "" if used_input.age_ms is None else f" ({used_input.age_ms:.0f} ms old)"
        lines.append(f"  {'used   ' if used_input.used else 'ignored'} {spoken(name)}: {used_input.why}{age}")
    return lines + ([f"  lower when: {verdict.to_lower}"] if verdict.to_lower else [])


def health_lines(system: SystemHealth) -> list[str]:
    """The health bar and one line a sensor and service that is not well."""
    whose = f"{system.vehicle}: " if system.vehicle else ""
    lines = [f"{whose}{coloured(system.colour.upper())}: {system.summary}"]
    for name, sensor in system.sensors.items():
        age = "never seen" if sensor.age_ms is None else f"age {sensor.age_ms:.0f} ms, {sensor.rate_hz:.1f} Hz"
        why = f": {sensor.reason}" if sensor.reason else ""
        lines.append(f"  {spoken(name):<14} {coloured(sensor.state, 13)} {coloured(sensor.source_kind, 10)} {age}{why}")
    for name, service in system.services.items():
        if not service.alive or service.state != "online":
            lines.append(f"  {name}: {'alive' if service.alive else 'gone'}, {service.state}: {service.reason}")
    return lines + [f"  {note}" for note in system.notes]


def _is_flat(value: Any) -> bool:
    if isinstance(value, dict):
        return not value
    if isinstance(value, list):
        return all(not isinstance(item, (dict, list)) for item in value)
    return True


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, bytes):
        return f"<{len(value)} bytes>"
    if isinstance(value, list):
        shown = ", ".join(_short(item) for item in value[:MAX_LIST])
        more = f", ... {len(value)} in all" if len(value) > MAX_LIST else ""
        return f"[{shown}{more}]"
    return str(value)
