"""`make bench`: every benchmark, or those named. Ratios against a plain reference in the same run; nothing is asserted.

python -m benchmarks                 all of them, some minutes
python -m benchmarks infra_lidar     the folder's speed; also infra_lidar.accuracy, ld06 ...
"""

from __future__ import annotations

import importlib
import platform
import sys
import time
from pathlib import Path

import benchmarks


def names() -> list[str]:
    """Modules below this folder that have a ``main()``, as ``folder.module``: each prints its own table."""
    root = Path(benchmarks.__path__[0])
    found = [file for file in root.glob("*/*.py") if "\ndef main() -> None:" in file.read_text()]
    return sorted(f"{file.parent.name}.{file.stem}" for file in found)


def full_name(asked: str) -> str | None:
    """``infra_lidar`` is the speed of that folder, ``ld06`` the only module of that name; None = there is none."""
    main_one = {"infra_lidar": "infra_lidar.speed", "radar": "radar.radar"}
    matches = [name for name in names() if name in (asked, main_one.get(asked)) or name.partition(".")[2] == asked]
    return main_one[asked] if main_one.get(asked) in matches else matches[0] if len(matches) == 1 else None


def main() -> None:
    """The command above."""
    asked = sys.argv[1:]
    unknown = {name for name in asked if full_name(name) is None}
    if unknown:
        sys.exit(f"no benchmark {', '.join(sorted(unknown))}; there are: {', '.join(names())}")
    print(f"Python {platform.python_version()}, {platform.machine()}; trust ratios more than milliseconds")
    for name in [full_name(name) for name in asked] or names():
        print(f"\n== {name}")
        started_s = time.perf_counter()
        sys.argv = [f"benchmarks.{name}"]
        importlib.import_module(f"benchmarks.{name}").main()
        print(f"   ({time.perf_counter() - started_s:.0f} s)")


if __name__ == "__main__":
    main()
