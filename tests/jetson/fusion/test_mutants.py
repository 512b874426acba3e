"""The mutation check itself works: run on the rules' settings here, on all of them by hand (see ``mutants.py``)."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.slow
def test_every_mutant_of_the_rules_settings_is_caught() -> None:
    script = Path(__file__).parent / "mutants.py"
    done = subprocess.run([sys.executable, str(script), "config"], capture_output=True, text=True, timeout=110)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "config: 5 mutants, 5 caught" in done.stdout
