"""Compile every kernel in as many processes as there are processors: the compiler itself works on one at a time.

    python -m services.infra_lidar.compile_together CONFIGURATION [PART ...]    # a helper

What has to be compiled comes in parts. Their numbers lie in a pipe, the standard input of a helper, one byte each, the
longest first; whoever is free takes the next one. When none is left a helper says so in a line. The parts that it is
told by name it compiles then, while the service is at work already.
"""

from __future__ import annotations

import gc
import logging
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from threading import Thread

import msgspec

from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.warm_up_parts import PARTS

log = logging.getLogger(__name__)

MAX_PROCESSES = 4
DONE = b"done\n"


def compile_together(config: InfraLidarConfig, later: Sequence[str]) -> None:
    """All parts, by this process and its helpers; returns when all are kept on disk but those for ``later``, which a
    helper goes on to compile."""
    processes = max(min(len(os.sched_getaffinity(0)), MAX_PROCESSES), 2 if later else 1)
    numbers = pipe_of([number for number, name in enumerate(PARTS) if name not in later])
    helpers = [_helper(numbers, config, [] if k else later) for k in range(processes - 1)]
    work_off(numbers, config)
    os.close(numbers)
    for helper in helpers:
        assert helper.stdout is not None
        if helper.stdout.readline() != DONE:  # then this process compiles what is missing
            log.warning("another compiling process ended early, with exit code %d", helper.wait())
        helper.stdout.close()
        Thread(target=helper.wait, daemon=True).start()


def _helper(numbers: int, config: InfraLidarConfig, later: Sequence[str]) -> subprocess.Popen[bytes]:
    words = [sys.executable, "-m", __name__, msgspec.json.encode(config).decode(), *later]
    return subprocess.Popen(words, stdin=numbers, stdout=subprocess.PIPE)


def work_off(numbers: int, config: InfraLidarConfig) -> list[str]:
    """Compile parts until no number is left in the pipe; returns their names."""
    done = []
    while number := os.read(numbers, 1):
        name, compile_part = list(PARTS.items())[number[0]]
        compile_part(config)
        done.append(name)
    return done


def pipe_of(numbers: Sequence[int]) -> int:
    """The end to read from; a read gives one number to one reader, and nothing when all are gone."""
    reading, writing = os.pipe()
    os.write(writing, bytes(numbers))
    os.close(writing)
    return reading


@contextmanager
def collecting_seldom() -> Iterator[None]:
    """The compiler makes millions of small objects and keeps most: to look for garbage among them costs a sixth."""
    before = gc.get_threshold()
    gc.set_threshold(200_000, 20, 100)
    try:
        yield
    finally:
        gc.set_threshold(*before)


def main() -> None:
    """A helper."""
    text, *later = sys.argv[1:]
    config = msgspec.json.decode(text, type=InfraLidarConfig)
    with collecting_seldom():
        work_off(sys.stdin.fileno(), config)
        os.write(sys.stdout.fileno(), DONE)
        os.nice(10)
        for name in later:
            PARTS[name](config)


if __name__ == "__main__":
    main()
