"""Makes docs/troubleshooting.md: what Spotter says when something is wrong, what that means, and what to do.

    python docs/troubleshooting.py            # writes the page
    python docs/troubleshooting.py --check    # exit code 1 if the page is not of these sources

The sentences are read from the sources, where they are made: fusion's faults, the doctor's findings, and the one line
with which a command ends. What a cause means is in docs/troubleshooting.toml.
"""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

NAME = re.compile(r"[A-Za-z]\w*")
PLACEHOLDER = re.compile("‹[^›]*›")
ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "troubleshooting.md"
HEALTH = ROOT / "services" / "jetson" / "fusion" / "health.py"
DOCTOR, COMMANDS = ROOT / "spotter_tools" / "doctor", ROOT / "spotter_tools" / "cli"


def template(node: ast.expr) -> str:
    """The words of a text that is put together: what is filled in stands as its name in angle brackets."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(template(part) for part in node.values)
    if isinstance(node, ast.FormattedValue):
        return template(node.value)
    if isinstance(node, ast.BoolOp):
        return template(node.values[-1])
    if isinstance(node, ast.IfExp):
        return template(node.body)
    if isinstance(node, ast.Call) and ast.unparse(node.func) == "str":
        return template(node.args[0])
    return f"‹{NAME.findall(ast.unparse(node))[-1]}›"


def calls(path: Path, name: str) -> Iterator[list[ast.expr]]:
    """The arguments of every call of a function of this name."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[-1] == name:
            yield [*node.args, *(keyword.value for keyword in node.keywords)]


def sentences_by_cause() -> dict[str, list[str]]:
    """Of every ``Fault(state, cause, sentence)`` in fusion's health."""
    found: dict[str, list[str]] = {}
    functions = [node for node in ast.walk(ast.parse(HEALTH.read_text())) if isinstance(node, ast.FunctionDef)]
    for function in functions:
        for node in ast.walk(function):
            if not (isinstance(node, ast.Call) and ast.unparse(node.func) == "Fault" and len(node.args) == 3):
                continue
            cause, sentence = node.args[1:]
            if isinstance(cause, ast.Constant):
                said = [template(one) for one in choices(sentence, function, functions)]
                found.setdefault(str(cause.value), []).extend(text for text in said if not PLACEHOLDER.fullmatch(text))
    return found


def choices(node: ast.expr, function: ast.FunctionDef, functions: list[ast.FunctionDef]) -> Iterator[ast.expr]:
    """Every text that an expression may stand for: both sides of a condition, assignments, what a method returns."""
    if isinstance(node, ast.IfExp):
        inner = [node.body, node.orelse]
    elif isinstance(node, ast.BoolOp):
        inner = node.values
    elif isinstance(node, ast.Name):
        inner = last_assigned(node, function)
    elif isinstance(node, ast.Call) and (method := called(node, functions)) is not None:
        function = method
        inner = [one.value for one in ast.walk(method) if isinstance(one, ast.Return) and one.value]
    else:
        yield node
        return
    for one in inner:
        yield from choices(one, function, functions)


def called(node: ast.Call, functions: list[ast.FunctionDef]) -> ast.FunctionDef | None:
    """The function of this file that is called; None for any other."""
    name = ast.unparse(node.func).rpartition(".")[2]
    return next((function for function in functions if function.name == name), None)


def last_assigned(name: ast.Name, function: ast.FunctionDef) -> list[ast.expr]:
    """What the name was given nearest above."""
    above = [
        one
        for one in ast.walk(function)
        if isinstance(one, ast.Assign) and ast.unparse(one.targets[0]) == name.id and one.lineno < name.lineno
    ]
    return [one.value for one in sorted(above, key=lambda one: one.lineno)[-1:]]


def findings() -> Iterator[tuple[str, str, str]]:
    """Check, what is wrong, what to do, of every finding of the doctor."""
    for path in sorted(DOCTOR.glob("*.py")):
        for name in ("broken", "warning"):
            for arguments in calls(path, name):
                if len(arguments) == 3:
                    check, what, do = map(template, arguments)
                    if not PLACEHOLDER.fullmatch(do) and do != "see the reason":
                        yield check, what, do


def endings() -> Iterator[tuple[str, str]]:
    """Command and sentence of every ``fail``."""
    for path in sorted(COMMANDS.glob("*.py")):
        for arguments in calls(path, "fail"):
            said = template(arguments[0])
            if not PLACEHOLDER.fullmatch(said):
                yield path.stem.replace("_", " "), said


def causes() -> dict[str, dict[str, str]]:
    """docs/troubleshooting.toml: cause -> what it means and what to do."""
    return tomllib.loads((ROOT / "docs" / "troubleshooting.toml").read_text())


def cell(text: str) -> str:
    """Text that fits a cell of a Markdown table."""
    return " ".join(text.split()).replace("|", "\\|")


def page() -> str:
    """The whole page."""
    said = sentences_by_cause()
    lines = [
        "# Troubleshooting",
        "",
        "Made by `python docs/troubleshooting.py` from the sentences in the sources; ‹names› are filled in. What every",
        "command says without a router, with a wrong name or file and after Ctrl-C: [situations.md](situations.md).",
        "",
        "## A sensor is not online",
        "",
        "`spotter health` and the page show state, cause and reason of every sensor.",
        "",
        "| cause | says | means | do |",
        "|---|---|---|---|",
    ]
    for cause, advice in causes().items():
        words = (
            "; ".join(filter(None, dict.fromkeys(said.get(cause, ())))) or "(the sensor's, router's or clock's words)"
        )
        lines.append(f"| `{cause}` | {cell(words)} | {cell(advice['means'])} | {cell(advice['do'])} |")
    lines += ["", "## `spotter doctor`", "", "| check | finds | do |", "|---|---|---|"]
    lines += [f"| {cell(check)} | {cell(what)} | {cell(do)} |" for check, what, do in dict.fromkeys(findings())]
    lines += ["", "## A command ends with one line", "", "| in | says |", "|---|---|"]
    lines += [f"| {where} | {cell(words)} |" for where, words in dict.fromkeys(endings())]
    return "\n".join(lines) + "\n"


def main() -> None:
    """The command above."""
    if "--check" not in sys.argv:
        PAGE.write_text(page())
    elif PAGE.read_text() != page():
        sys.exit("docs/troubleshooting.md is not of these sources: python docs/troubleshooting.py writes it")


if __name__ == "__main__":
    main()
