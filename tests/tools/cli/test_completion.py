"""The shell completes our commands, as `spotter --install-completion` sets it up."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.parametrize(("typed", "offered"), [("spotter exp", "export"), ("spotter incident ver", "verify")])
def test_bash_is_offered_our_commands(typed: str, offered: str) -> None:
    asked = {"_SPOTTER_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(len(typed.split()) - 1)}
    script = str(Path(sys.executable).with_name("spotter"))
    result = subprocess.run([script], env={**os.environ, **asked}, capture_output=True, text=True, check=False)
    assert offered in result.stdout.split()
