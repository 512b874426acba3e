"""Messages as text for people."""

from __future__ import annotations

from typing import Any

from common.messages import SystemHealth, Verdict

MAX_LIST = 8


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


def verdict_line(verdict: Verdict | None, silent_s: float) -> str:
    """One line: level, permission, why; or that there is none."""
    if verdict is None:
        return f"NO VERDICT for {silent_s:.1f} s: treat as STOP; is fusion running?"
    flags = [name for name in ("confirmed", "suppressed", "blind") if getattr(verdict, name)] + (
        [verdict.advisory] if verdict.advisory else []
    )
    marks = f" [{', '.join(flags)}]" if flags else ""
    return f"{verdict.level} -> {verdict.permission}{marks}  {verdict.because} (rule {verdict.rule})"


def reason_lines(verdict: Verdict) -> list[str]:
    """What each sensor contributed to the verdict, why, and what would have to change for the level to drop."""
    lines = []
    for name, told in verdict.inputs.items():
        age = "" if told.age_ms is None else f" ({told.age_ms:.0f} ms old)"
        lines.append(f"  {'used   ' if told.used else 'ignored'} {name}: {told.why}{age}")
    return lines + ([f"  lower when: {verdict.to_lower}"] if verdict.to_lower else [])


def health_lines(system: SystemHealth) -> list[str]:
    """The health bar and one line a sensor and service that is not well."""
    lines = [f"{system.colour.upper()}: {system.summary}"]
    for name, sensor in system.sensors.items():
        age = "never seen" if sensor.age_ms is None else f"age {sensor.age_ms:.0f} ms, {sensor.rate_hz:.1f} Hz"
        lines.append(f"  {name:<12} {sensor.state:<13} {age}{': ' + sensor.reason if sensor.reason else ''}")
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
