"""Breaks the rules in one place at a time and asks whether the tests notice.

    python tests/jetson/fusion/mutants.py [module ...] [--part 1/3]

A module is one of fusion's, or has its full name: what decides about the way ahead lies with the sensors and the gate.
Every comparison, boolean operator, negation, number, level and state of a module is changed once (a mutant); for each
mutant a forked process runs the module's tests until the first failure, those of the module alone first. A mutant that
no test notices is printed, and the exit code is 1. Mutants that cannot make a difference are listed with the reason in
``equivalent_mutants.toml``. ``--part 1/3`` runs the first of every three mutants.
"""

from __future__ import annotations

import argparse
import ast
import copy
import importlib
import importlib.util
import io
import os
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from types import ModuleType

import hypothesis  # noqa: F401  # here, so that not every fork has to
import numpy as np  # noqa: F401
import pytest

HERE = Path(__file__).parent
ROOT = HERE.parents[2]
PACKAGE = "services.jetson.fusion"
CAUGHT, SURVIVED, BROKEN = 0, 3, 4

RULE_TESTS = (
    "test_verdict_votes.py",
    "test_abreast.py",
    "test_verdict_memory.py",
    "test_claims.py",
    "test_fourth_sensor.py",
    "test_reversing.py",
    "test_coverage.py",
    "test_roadside_verdict.py",
    "test_verdict_table.py",
    "test_verdict_properties.py",
)
MEMORY_TESTS = (
    "test_abreast.py",
    "test_claims_seen.py",
    "test_claims_ended.py",
    "test_claims.py",
    "test_verdict_memory.py",
    "test_written_memory.py",
)
TESTS: dict[str, tuple[str, ...]] = {
    "verdict": RULE_TESTS,
    "evidence": RULE_TESTS,
    "config": (*RULE_TESTS, "test_hidden.py", "test_config.py"),
    "coverage": ("test_coverage.py", "test_hidden.py"),
    "hidden": ("test_hidden.py",),
    "abreast": ("test_abreast.py",),
    "claims": MEMORY_TESTS,
    "places": ("test_places.py",),
    "suppression": ("test_verdict_memory.py", "test_field_suppression.py"),
    "recovery": ("test_recovery.py",),
    "bar": ("test_bar.py", "test_health.py", "test_fourth_sensor.py"),
    "health": ("test_health_limits.py", "test_health.py", "test_faults.py", "test_clocks_in_fusion.py"),
    "clocks": ("test_clocks.py", "test_clocks_in_fusion.py"),
    "roadside": ("test_roadside.py", "test_roadside_verdict.py"),
    "outlines": ("test_outlines.py", "test_outlines_steps.py"),
    "own_track": ("test_own_track.py",),
    "dating": ("test_health_limits.py", "test_clocks.py", "test_clocks_in_fusion.py", "test_aged_by_stamp.py"),
    "common.path": ("common/test_path.py", "common/test_path_limits.py", "jetson/fusion/test_config.py"),
    "services.radar_pi.alarm": ("radar_pi/test_alarm.py",),
    "services.jetson.lidar.way": ("jetson/lidar/test_way.py",),
    "services.jetson.gate.checks": ("jetson/gate/test_pipeline.py",),
    "services.jetson.gate.pipeline": ("jetson/gate/test_pipeline.py",),
}
ONLY_IN_CLASS = {"config": "RulesConfig"}  # the rest of the configuration is not rules

COMPARISONS: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
WORDS = {
    "SAFE": "CAUTION", "CAUTION": "IMMINENT", "IMMINENT": "CAUTION", "GO": "SLOW", "SLOW": "STOP", "STOP": "GO",
    "online": "degraded", "degraded": "disconnected", "disconnected": "online", "limited": "full", "off": "limited",
    "full": "off", "green": "amber", "amber": "red", "red": "green",
}  # fmt: skip

# What cannot be noticed because nothing changes: by module, "line  [mutation]" and why.
EQUIVALENT: dict[str, dict[str, str]] = tomllib.loads((HERE / "equivalent_mutants.toml").read_text())


def mutants(source: str, only_in_class: str | None = None) -> Iterator[tuple[str, ast.Module]]:
    """Pairs of (what was changed, the changed module); what comes twice is numbered."""
    tree = ast.parse(source)
    lines = source.splitlines()
    counts: Counter[str] = Counter()
    for index, node in enumerate(_nodes(tree, only_in_class)):
        for what in _mutations(node):
            changed = copy.deepcopy(tree)
            twin = list(_nodes(changed, only_in_class))[index]
            text = _apply(twin, what)
            line = getattr(node, "lineno", 0)
            name = f"{lines[line - 1].strip()}  [{text}]"
            counts[name] += 1
            yield name if counts[name] == 1 else f"{name} {counts[name]}", ast.fix_missing_locations(changed)


def _nodes(tree: ast.Module, only_in_class: str | None) -> Iterator[ast.AST]:
    """All nodes of executable code: no docstrings, no annotations, no imports."""
    todo: list[ast.AST] = [n for n in tree.body if only_in_class is None or getattr(n, "name", "") == only_in_class]
    while todo:
        node = todo.pop(0)
        yield node
        skipped = {id(getattr(node, name, None)) for name in ("annotation", "returns")}
        skipped |= {id(child) for child in getattr(node, "decorator_list", [])}
        if isinstance(node, ast.ClassDef):
            skipped |= {id(child) for child in node.keywords}
        todo += [child for child in ast.iter_child_nodes(node) if id(child) not in skipped and not _is_prose(child)]


def _is_prose(node: ast.AST) -> bool:
    """Docstrings, messages, arguments' annotations and ``Literal[...]`` types."""
    is_docstring = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    is_type = isinstance(node, ast.Subscript) and getattr(node.value, "id", "") == "Literal"
    return is_docstring or is_type or isinstance(node, ast.JoinedStr | ast.arguments)


def _mutations(node: ast.AST) -> list[int]:
    match node:
        case ast.Compare():
            return [i for i, op in enumerate(node.ops) if type(op) in COMPARISONS]
        case ast.BoolOp() | ast.UnaryOp(op=ast.Not()):
            return [0]
        case ast.Constant(value=bool() | int() | float()):
            return [0]
        case ast.Constant(value=str()) if node.value in WORDS:
            return [0]
    return []


def _apply(node: ast.AST, which: int) -> str:
    """Change the node in place; returns what was done."""
    match node:
        case ast.Compare():
            old = node.ops[which]
            node.ops[which] = COMPARISONS[type(old)]()
            return f"{type(old).__name__} -> {type(node.ops[which]).__name__}"
        case ast.BoolOp():
            node.op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
            return f"-> {type(node.op).__name__}"
        case ast.UnaryOp():
            node.op = ast.UAdd()  # +condition: the same truth value, not negated
            return "not dropped"
        case ast.Constant(value=bool()):
            node.value = not node.value
        case ast.Constant(value=str() as word):
            node.value = WORDS[word]
        case ast.Constant(value=int() | float() as number):
            node.value = number + 1 if isinstance(number, int) else number * 1.1 if number else 0.1
    return f"-> {node.value!r}" if isinstance(node, ast.Constant) else ""


def is_noticed(name: str, tree: ast.Module) -> bool:
    """Run the module's tests against the mutant in a forked process."""
    child = os.fork()
    if child == 0:
        os._exit(_run_tests(name, tree))
    _, status = os.waitpid(child, 0)
    outcome = os.waitstatus_to_exitcode(status)
    if outcome not in (CAUGHT, SURVIVED):
        raise RuntimeError(f"the tests of {name} could not be run")
    return outcome == CAUGHT


def _run_tests(name: str, tree: ast.Module) -> int:
    install(name, tree)
    options = ["-x", "-q", "--assert=plain", "-p", "no:cacheprovider", "-o", "addopts=--import-mode=importlib"]
    options += ["-o", f"pythonpath={ROOT}"]
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        code = pytest.main([*options, *(str((ROOT / "tests" if "/" in test else HERE) / test) for test in TESTS[name])])
    return {
        pytest.ExitCode.OK: SURVIVED,
        pytest.ExitCode.TESTS_FAILED: CAUGHT,
        pytest.ExitCode.INTERRUPTED: CAUGHT,
    }.get(pytest.ExitCode(code), BROKEN)


def full_name_of(name: str) -> str:
    """Without a dot it is a module of fusion."""
    return name if "." in name else f"{PACKAGE}.{name}"


def install(name: str, tree: ast.Module) -> None:
    """Put the mutant in the place of the module; all of its package is imported afresh and finds it there."""
    full_name = full_name_of(name)
    package, _, leaf = full_name.rpartition(".")
    for loaded in [module for module in sys.modules if module.startswith(package + ".")]:
        del sys.modules[loaded]
    spec = importlib.util.find_spec(full_name)
    assert spec is not None
    module = ModuleType(full_name)
    module.__file__, module.__spec__ = spec.origin, spec
    sys.modules[full_name] = module
    exec(compile(tree, str(spec.origin), "exec"), module.__dict__)
    setattr(importlib.import_module(package), leaf, module)


def check(name: str, part: int = 1, parts: int = 1) -> tuple[int, list[str]]:
    """(number of mutants that can make a difference, those that nobody noticed), of one part of them."""
    source = (ROOT / f"{full_name_of(name).replace('.', '/')}.py").read_text()
    if is_noticed(name, ast.parse(source)):
        raise RuntimeError(f"the tests of {name} fail without any mutant")
    all_of_them = list(mutants(source, ONLY_IN_CLASS.get(name)))
    unknown = EQUIVALENT.get(name, {}).keys() - {what for what, _ in all_of_them}
    if unknown:
        raise RuntimeError(f"{name} has no such mutant any more: {', '.join(sorted(unknown))}")
    selected = [(what, tree) for what, tree in all_of_them if what not in EQUIVALENT.get(name, {})][part - 1 :: parts]
    return len(selected), [what for what, tree in selected if not is_noticed(name, tree)]


def main() -> int:
    """Exit code 1 when a mutant was not noticed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("modules", nargs="*", default=list(TESTS))
    parser.add_argument("--part", default="1/1", help="e.g. 2/3: of every three mutants the second")
    given = parser.parse_args()
    part, parts = map(int, given.part.split("/"))
    missed = 0
    for name in given.modules:
        count, survivors = check(name, part, parts)
        sys.stdout.write(f"{name}: {count} mutants, {count - len(survivors)} caught\n")
        sys.stdout.writelines(f"    not noticed: {what}\n" for what in survivors)
        sys.stdout.flush()
        missed += len(survivors)
    return 1 if missed else 0


if __name__ == "__main__":
    raise SystemExit(main())
