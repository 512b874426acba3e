"""Compares sentences without their numbers."""

from __future__ import annotations


def without_numbers(text: str) -> str:
    """``text`` without its digits: the same fault says the same, however long it lasts."""
    return "".join(character for character in text if not character.isdigit())
