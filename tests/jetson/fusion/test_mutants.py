"""The mutator: what it changes and what it leaves alone. The check itself is run by hand or by CI (``mutants.py``)."""

from __future__ import annotations

import ast

from tests.jetson.fusion import mutants as mutator

SOURCE = '''"""Docstring with 1 and SAFE."""
LIMIT = 2

class Rules:
    hold: float = 0.5

def decide(level: str, age: int = 3) -> str:
    """SAFE."""
    if level == "SAFE" and not age < LIMIT:
        return f"SAFE {age}"
    return "STOP" if level in ("CAUTION", "other") else "other"
'''


def test_each_place_is_changed_once() -> None:
    changed = sorted(what.partition("  ")[2] for what, _ in mutator.mutants(SOURCE))
    assert changed == sorted(
        ["[-> 3]", "[-> 0.55]", "[Eq -> NotEq]", "[-> 'CAUTION']", "[-> Or]", "[not dropped]", "[Lt -> LtE]",
         "[-> 'GO']", "[In -> NotIn]", "[-> 'IMMINENT']"]
    )  # fmt: skip


def test_every_mutant_is_a_program_that_differs() -> None:
    original = ast.unparse(ast.parse(SOURCE))
    texts = [ast.unparse(tree) for _, tree in mutator.mutants(SOURCE)]
    assert original not in texts
    assert len(set(texts)) == len(texts)
    for text in texts:
        compile(text, "mutant", "exec")


def test_it_can_be_kept_to_one_class() -> None:
    assert [what for what, _ in mutator.mutants(SOURCE, "Rules")] == ["hold: float = 0.5  [-> 0.55]"]
