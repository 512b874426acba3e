"""Lets ``spotter_client`` find our package ``common`` where another package of that name comes first on the path.

A notebook in a folder with a ``common`` of its own would otherwise give us that one. While we import, ours comes first;
afterwards the name belongs to the notebook again, whichever of the two it means there. Nothing happens where ``common``
is ours anyway.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

FOLDER = Path(__file__).resolve().parent.parent  # of our packages
NAME = "common"


@contextmanager
def own_common() -> Iterator[None]:
    """Within it ``import common`` means ours."""
    if _is_ours():
        yield
        return
    theirs = _take_out()
    sys.path.insert(0, str(FOLDER))
    importlib.invalidate_caches()
    try:
        yield
    finally:
        sys.path.remove(str(FOLDER))
        _take_out()
        sys.modules.update(theirs)


def _is_ours() -> bool:
    loaded = sys.modules.get(NAME)
    spec = loaded.__spec__ if loaded is not None else importlib.util.find_spec(NAME)
    places = list(spec.submodule_search_locations or []) if spec is not None else []
    return [Path(place).resolve() for place in places] == [FOLDER / NAME]


def _take_out() -> dict[str, ModuleType]:
    names = [name for name in sys.modules if name == NAME or name.startswith(f"{NAME}.")]
    return {name: sys.modules.pop(name) for name in names}
