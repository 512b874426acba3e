"""The README tells the truth: its table is the topics table, its commands exist, its links lead somewhere."""

from __future__ import annotations

import importlib
import re
import textwrap
import tomllib
from pathlib import Path

import pytest
from typer.main import get_command

from common.topics import DATA_TOPICS, OPTIONAL_SERVICES, SERVICES, Topic
from spotter_tools.cli.__main__ import app

REPOSITORY = Path(__file__).parent.parent
README = (REPOSITORY / "README.md").read_text()
DOCUMENTS = sorted(
    path
    for path in REPOSITORY.rglob("*.md")
    if not any(part.startswith((".", "node_modules")) for part in path.relative_to(REPOSITORY).parts)
)


@pytest.mark.parametrize("topic", DATA_TOPICS, ids=lambda topic: topic.name)
def test_the_wire_table_is_the_topics_table(topic: Topic) -> None:
    host = {row.name: row.host for row in SERVICES + OPTIONAL_SERVICES}[topic.service]
    row = next((line for line in README.splitlines() if line.startswith(f"| `{topic.key(host)}` |")), None)
    assert row is not None, f"{topic.key(host)} is not in the README"
    _, _, message, nominal, limit, _ = (cell.strip() for cell in row.split("|"))
    assert message == topic.message.__name__
    assert nominal == f"{topic.nominal_hz:g} Hz" + (", on demand" if topic.on_demand else "")
    assert limit == (f"{topic.age_limit_s:g} s" if topic.age_limit_s else "")


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(REPOSITORY)))
def test_spotter_commands_in_the_documents_exist(document: Path) -> None:
    known = set(get_command(app).commands)  # type: ignore[attr-defined]
    for command in re.findall(r"(?:^|`|\s)spotter ([a-z0-9]+)", document.read_text()):
        assert command in known | {"is"}, f"{document.name}: `spotter {command}` does not exist"


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(REPOSITORY)))
def test_links_lead_somewhere(document: Path) -> None:
    for target in re.findall(r"\]\(([^)#\s]+)", document.read_text()):
        if not target.startswith("http"):
            assert (document.parent / target).exists(), f"{document.name}: {target}"


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(REPOSITORY)))
def test_what_is_to_be_copied_into_a_toml_file_is_toml(document: Path) -> None:
    for block in re.findall(r"```toml\n(.*?)```", document.read_text(), re.DOTALL):
        tomllib.loads(textwrap.dedent(block))


def test_every_command_of_the_pages_is_known_to_docs_check(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else `make docs-check`, which takes minutes, fails at its end."""
    monkeypatch.syspath_prepend(REPOSITORY / "docs")
    check = importlib.import_module("check")
    assert check.missing_from_plan(check.read_plan()) == []
