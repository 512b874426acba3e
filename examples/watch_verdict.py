"""Prints every change of the verdict for some seconds, and why.

python examples/watch_verdict.py [ENDPOINT [SECONDS]]
"""

from __future__ import annotations

import sys

from spotter_client import Verdict, connect


def main(endpoint: str = "tcp/127.0.0.1:7447", seconds: float = 10.0) -> list[str]:
    """Print and return a line for each new verdict."""
    lines: list[str] = []
    shown = ("", "")
    with connect(endpoint) as bus:
        for verdict in bus.stream("*/fusion/verdict", Verdict, seconds=seconds):
            if (verdict.level, verdict.rule) != shown:
                shown = (verdict.level, verdict.rule)
                lines.append(f"{verdict.level} -> {verdict.permission}: {verdict.because}")
                sys.stdout.write(lines[-1] + "\n")
    return lines


if __name__ == "__main__":
    try:
        main(*sys.argv[1:2], *[float(text) for text in sys.argv[2:3]])  # type: ignore[arg-type]
    except KeyboardInterrupt:
        pass
    except ConnectionError as error:  # no router answers
        sys.exit(str(error))
