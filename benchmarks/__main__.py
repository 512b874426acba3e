"""`make bench`: every benchmark, or those named. Ratios against a plain reference in the same run; nothing is asserted.

python -m benchmarks                 all of them, some minutes
python -m benchmarks radar ld06      these two
"""

from __future__ import annotations

import importlib
import pkgutil
import platform
import sys
import time
from pathlib import Path

import benchmarks


def names() -> list[str]:
    """Modules of this folder that have a ``main()``: each prints its own table."""
    found = []
    for module in pkgutil.iter_modules(benchmarks.__path__):
        source = (Path(benchmarks.__path__[0]) / f"{module.name}.py").read_text()
        if module.name != "__main__" and "\ndef main() -> None:" in source:
            found.append(module.name)
    return sorted(found)


def main() -> None:
    asked = sys.argv[1:]
    unknown = set(asked) - set(names())
    if unknown:
        sys.exit(f"no benchmark {', '.join(sorted(unknown))}; there are: {', '.join(names())}")
    print(f"Python {platform.python_version()}, {platform.machine()}; trust ratios more than milliseconds")
    for name in asked or names():
        print(f"\n== {name}")
        started_s = time.perf_counter()
        sys.argv = [f"benchmarks.{name}"]
        importlib.import_module(f"benchmarks.{name}").main()
        print(f"   ({time.perf_counter() - started_s:.0f} s)")


if __name__ == "__main__":
    main()
