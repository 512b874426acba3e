"""Kernels kept on disk are compiled again when any file changes that they were made from, and only then."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from common import compiled_from
from common.compiled_from import ROOT, imported, sources


def _imported_by_the_parser(file: Path) -> Iterator[Path]:
    """What ``imported`` should find: slow and sure."""
    for node in ast.parse(file.read_bytes()).body:
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [each.name for each in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.module, f"{file}: a relative import"
            names = [node.module, *(f"{node.module}.{each.name}" for each in node.names)]
        for name in names:
            place = ROOT.joinpath(*name.split("."))
            if name.split(".")[0] in ("common", "services"):
                yield from (path for path in (place.with_suffix(".py"), place / "__init__.py") if path.is_file())


def test_imports_are_found_as_by_the_parser() -> None:
    files = [file for package in ("common", "services") for file in ROOT.joinpath(package).rglob("*.py")]
    assert len(files) > 100
    for file in files:
        assert set(imported(file)) == set(_imported_by_the_parser(file)), file


@pytest.mark.parametrize(
    "line",
    [
        "import common.a.b",
        "import common.a.b as c",
        "from common.a.b import c, d",
        "from common.a import b",
        "from common.a import x, b as c  # b",
        "from common.a import (  # all (of\n    x,  # one)\n    b,\n)",
    ],
)
def test_ways_to_import(line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled_from, "ROOT", tmp_path)
    wanted, other, importing = (tmp_path / "common" / name for name in ("a/b.py", "other.py", "importing.py"))
    wanted.parent.mkdir(parents=True)
    wanted.touch()
    other.write_text("import numpy")
    importing.write_text(f'"""A text."""\n{line}\nX = 1\n\n\ndef f():\n    from common import other\n')
    assert imported(importing) == (wanted,)


def test_sources_are_found_through_others_and_in_circles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled_from, "ROOT", tmp_path)
    texts = {"a": "import common.b", "b": "from common import c", "c": "import common.a", "d": "import common.a"}
    (tmp_path / "common").mkdir()
    for name, text in texts.items():
        (tmp_path / "common" / f"{name}.py").write_text(text)
    assert {file.stem for file in sources(tmp_path / "common" / "a.py")} == {"a", "b", "c"}


USE_ONE = """
import numpy as np
from services.infra_lidar.kernels_returns import beams_seen
beams_seen(np.zeros((1, 2), np.float32)[:, 0], np.zeros(256, bool))
print(beams_seen.py_func.__code__.co_filename, "kept" if beams_seen.stats.cache_hits else "compiled")
"""


@pytest.mark.parametrize("kept_in_tree", [True, False])
def test_an_update_of_what_a_kernel_calls_compiles_it_again(kept_in_tree: bool, tmp_path: Path) -> None:
    tree, environment = tmp_path / "tree", dict(os.environ)
    environment.pop("NUMBA_CACHE_DIR", None)
    if not kept_in_tree:
        environment["NUMBA_CACHE_DIR"] = str(tmp_path / "kept")
    for package in ("common", "services"):
        shutil.copytree(ROOT / package, tree / package, ignore=shutil.ignore_patterns("__pycache__", "*.npz", "*.onnx"))

    def use() -> str:
        words = [sys.executable, "-c", USE_ONE]
        told = subprocess.run(words, cwd=tree, env=environment, capture_output=True, text=True, check=True).stdout
        file, how = told.split()
        assert Path(file).is_relative_to(tree)
        return how

    assert use() == "compiled"
    assert use() == "kept"
    with (tree / "services/infra_lidar/vectors.py").open("a") as file:
        file.write("\n# updated\n")
    assert use() == "compiled"
    with (tree / "services/infra_lidar/tracking_step.py").open("a") as file:
        file.write("\n# nothing that this kernel is made from\n")
    assert use() == "kept"
