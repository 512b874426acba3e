"""The floors of the tree: imports go down, functions take few arguments, libraries keep their attributes."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parent.parent
FLOORS = ("common", "spotter_client", "spotter_sim", "services", "spotter_tools", "benchmarks")  # from below
COMMAND_LINES = ("spotter_tools/cli/", "services/infra_lidar/training/commands.py")  # parameters are options there
CLOCK_OF_FUSION = "services/blackbox/clock.py"  # measures this host's clock against fusion's, by fusion's own method
MAX_LINES = 300
MAX_ARGUMENTS = 6
INTERNALS = ("numba.core", "numba.np", "numba.cpython", "numba.extending", "llvmlite")


def checked_files() -> list[str]:
    paths = [str(path.relative_to(REPOSITORY)) for floor in FLOORS for path in REPOSITORY.glob(f"{floor}/**/*.py")]
    return sorted(paths)


FILES = checked_files()


def imported_modules(tree: ast.AST) -> Iterator[str]:
    """Full names: of import statements, and of ``import_module`` with a literal or an f-string that begins with one."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Call) and node.args and ast.unparse(node.func).split(".")[-1] == "import_module":
            first: ast.expr = node.args[0]
            if isinstance(first, ast.JoinedStr) and first.values:
                first = first.values[0]
            if isinstance(first, ast.Constant) and isinstance(first.value, str):
                yield first.value


def family(name: str) -> str:
    """The service that a module of ``services`` belongs to; the Jetson's services are one family."""
    return name.split(".")[1] if "." in name else ""


def upward(path: str, source: str) -> list[str]:
    """Imports of ``path`` that go to a higher floor, or to another service."""
    own, module = FLOORS.index(path.split("/")[0]), path.replace("/", ".")
    found = []
    for name in imported_modules(ast.parse(source)):
        top = name.split(".")[0]
        if top not in FLOORS:
            continue
        other_service = top == "services" and module.startswith("services.") and family(name) != family(module)
        if path == CLOCK_OF_FUSION and name.startswith("services.jetson.fusion."):
            continue
        if FLOORS.index(top) > own or other_service:
            found.append(name)
    return found


def long_signatures(source: str) -> Iterator[str]:
    """Functions with too many arguments. A command's parameters are its options: it may have more."""
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        decorators = [ast.unparse(decorator) for decorator in node.decorator_list]
        if any(".command" in decorator or ".callback" in decorator for decorator in decorators):
            continue
        names = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
        if len(names) - (names[:1] in (["self"], ["cls"])) > MAX_ARGUMENTS:
            yield node.name


def third_party_names(tree: ast.AST) -> set[str]:
    """Names in a file that an import statement binds to something of a third party."""
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            bound = [(alias.name, alias.asname or alias.name.split(".")[0]) for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            bound = [(node.module, alias.asname or alias.name) for alias in node.names]
        else:
            continue
        names |= {name for module, name in bound if module.split(".")[0] not in {*FLOORS, *sys.stdlib_module_names}}
    return names


def patches(source: str) -> list[str]:
    """Assignments to attributes of imported third-party names or to any ``__class__``, and imports of internals."""
    tree = ast.parse(source)
    theirs, found = third_party_names(tree), []
    for node in ast.walk(tree):
        targets: list[ast.expr] = []
        if isinstance(node, ast.Assign):
            targets = node.targets
        elif isinstance(node, ast.AugAssign | ast.AnnAssign):
            targets = [node.target]
        elif isinstance(node, ast.Call) and ast.unparse(node.func) == "setattr" and node.args:
            targets = [ast.Attribute(node.args[0], "set by setattr")]
        for target in targets:
            if isinstance(target, ast.Attribute):
                owner = ast.unparse(target.value).split(".")[0]
                if owner in theirs or target.attr == "__class__":
                    found.append(ast.unparse(target))
    for name in imported_modules(tree):
        private = name.split(".")[0] not in {*FLOORS, *sys.stdlib_module_names} and any(
            part.startswith("_") and not part.startswith("__") for part in name.split(".")
        )
        if private or name.startswith(INTERNALS):
            found.append(name)
    return found


@pytest.mark.parametrize("path", FILES)
def test_imports_go_down(path: str) -> None:
    assert not upward(path, (REPOSITORY / path).read_text())


@pytest.mark.parametrize("path", FILES)
def test_libraries_are_used_by_their_public_interface(path: str) -> None:
    assert not patches((REPOSITORY / path).read_text())


def test_files_are_short_and_functions_take_few_arguments() -> None:
    found = set()
    for path in FILES:
        source = (REPOSITORY / path).read_text()
        if len(source.splitlines()) > MAX_LINES:
            found.add(path)
        if not path.startswith(COMMAND_LINES):
            found |= {f"{path}:{name}" for name in long_signatures(source)}
    assert not found


def test_helpers_of_tests_take_few_arguments() -> None:
    """What a test itself takes are fixtures and the columns of its table."""
    helpers = [
        f"{path.name}:{name}"
        for path in (REPOSITORY / "tests").rglob("*.py")
        for name in long_signatures(path.read_text())
        if not name.startswith("test_")
    ]
    assert not helpers


@pytest.mark.parametrize(
    "source",
    ["import services.jetson.lidar", "from spotter_tools import cli", "import_module(f'services.{name}.reprocess')"],
)
def test_an_upward_import_is_found(source: str) -> None:
    assert upward("common/clock.py", source)


@pytest.mark.parametrize(
    "source",
    [
        "import numba\nnumba.njit = None",
        "from numba import types\nsetattr(types, 'x', 1)",
        "import zenoh\nzenoh.a.b += 1",
        "thing.__class__ = Other",
        "from numba.core import types",
        "import llvmlite.ir",
        "from scipy._lib import doccer",
    ],
)
def test_a_patch_or_an_internal_import_is_found(source: str) -> None:
    assert patches(source)
