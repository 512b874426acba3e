"""The looks in docs/bring-up are what the programs say: run as written, compared but for their figures."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

PAGES = sorted((Path(__file__).parents[1] / "docs" / "bring-up").glob("*.md"))
LOOK = re.compile(r"^\$ (spotter-[\w-]+ .*? look)\n((?:(?:sees|NOTHING| {8}->).*\n)+)", re.MULTILINE)
SHOWN = [(page.name, *found) for page in PAGES for found in LOOK.findall(page.read_text())]


def plain(text: str) -> str:
    """Without figures, levels and what the scenario has in view at the moment."""
    text = re.sub(r"demo network on CPU.*", "demo network on CPU", text)
    text = re.sub(r"(?:no track|nearest track [\d.]+ m, \w+)", "track", text)
    return re.sub(r"[-+]?\d+(?:\.\d+)?|SAFE|CAUTION|IMMINENT", "N", text)


def test_there_is_a_look_on_every_page() -> None:
    assert {name for name, _, _ in SHOWN} == {page.name for page in PAGES}
    assert len(SHOWN) == 5


@pytest.mark.slow
@pytest.mark.parametrize(("page", "command", "said"), SHOWN)
def test_a_look_says_what_the_page_shows(page: str, command: str, said: str) -> None:
    program, *words = shlex.split(command)
    completed = subprocess.run(
        [str(Path(sys.executable).with_name(program)), *words], capture_output=True, text=True, timeout=120, check=False
    )
    assert plain(completed.stdout) == plain(said), page
