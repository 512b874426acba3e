"""The page of situations is of these commands, and some of them are run again: what they say is what the page says."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

DOCS = Path(__file__).parent.parent / "docs"


def script(name: str) -> ModuleType:
    """A script of docs/, which is no package."""
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # a dataclass looks itself up there
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def situations() -> ModuleType:
    return script("situations")


@pytest.fixture(scope="module")
def troubleshooting() -> ModuleType:
    return script("troubleshooting")


@pytest.fixture(scope="module")
def check() -> ModuleType:
    return script("check")


def test_the_page_is_of_these_cases_and_shows_no_traceback(situations: ModuleType) -> None:
    page = situations.PAGE.read_text()
    for row in situations.CASES.values():
        for words in row.values():
            assert f"| `spotter {situations.shown(words)}` |" in page, words
    assert "Traceback" not in page


@pytest.mark.slow
@pytest.mark.system
@pytest.mark.parametrize("command", ["info", "export"])
def test_what_is_said_is_what_the_page_says(situations: ModuleType, command: str) -> None:
    answers = situations.all_outputs(command, workers=2)
    assert situations.problems(answers) == []
    page = situations.PAGE.read_text()
    for (name, situation), said in answers.items():
        assert f"| `spotter {situations.shown(situations.CASES[name][situation])}` | {said.cell} |" in page


def test_every_cause_of_a_sensor_s_fault_is_explained(troubleshooting: ModuleType) -> None:
    """And what a router says of a host that it cannot link has the causes of LinkFault."""
    in_the_source = set(troubleshooting.sentences_by_cause()) | {"clock", "certificate"}
    assert in_the_source == set(troubleshooting.causes())
    page = troubleshooting.page()
    for cause in in_the_source:
        assert f"\n| `{cause}` | " in page
    assert "it is ‹age_s› s old" in page  # a sentence that is put together elsewhere


def test_findings_and_endings_are_read_from_the_sources(troubleshooting: ModuleType) -> None:
    assert ("private key", "‹files› can be read by others", "chmod 600 ‹files›") in set(troubleshooting.findings())
    assert ("export", "‹out›: is already there; --force overwrites it") in set(troubleshooting.endings())


def test_commands_are_found_in_blocks_and_in_spans(check: ModuleType) -> None:
    text = "`spotter ls` and\n```sh\nmake demo   # starts\n\nspotter hz '*/*'\n```\n`x = 1` `spotter-NAME`"
    assert list(check.commands_of(text)) == ["make demo", "spotter hz '*/*'", "spotter ls", "spotter-NAME"]


def test_the_page_of_sentences_is_of_these_sources(troubleshooting: ModuleType) -> None:
    wanted = "docs/troubleshooting.md is of other sources; python docs/troubleshooting.py writes it"
    assert troubleshooting.PAGE.read_text() == troubleshooting.page(), wanted
