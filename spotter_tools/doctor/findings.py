"""What a check found."""

from __future__ import annotations

from typing import Literal

import msgspec

Grade = Literal["ok", "warning", "broken"]


class Finding(msgspec.Struct, frozen=True, kw_only=True):
    """One line of the report; ``do`` is empty only when there is nothing to do."""

    check: str
    grade: Grade
    what: str
    do: str = ""


def ok(check: str, what: str) -> Finding:
    """All is well."""
    return Finding(check=check, grade="ok", what=what)


def warning(check: str, what: str, do: str) -> Finding:
    """It works, but not for long or not well; ``do`` says what to do about it."""
    return Finding(check=check, grade="warning", what=what, do=do)


def broken(check: str, what: str, do: str) -> Finding:
    """It cannot work; ``do`` says what to do about it."""
    return Finding(check=check, grade="broken", what=what, do=do)
