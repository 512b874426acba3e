"""Kernels that come with an installation: copied once, added to, replaced by those of the next one, and really used."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from services.infra_lidar.shipped import STAMP, lay_out, lay_out_own


@pytest.fixture
def shipped(tmp_path: Path) -> Path:
    folder = tmp_path / "shipped"
    (folder / "a").mkdir(parents=True)
    (folder / "a" / "one.nbi").write_text("index")
    (folder / STAMP).write_text("first")
    return folder


def test_laid_out_once_for_each_installation(shipped: Path, tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    assert lay_out(shipped, kept)
    assert (kept / "a" / "one.nbi").read_text() == "index"
    (kept / "a" / "one.nbi").write_text("index with what this machine compiled")
    (kept / "own.nbi").write_text("own")
    assert not lay_out(shipped, kept)
    assert (kept / "a" / "one.nbi").read_text() == "index with what this machine compiled"
    (shipped / STAMP).write_text("second")
    assert lay_out(shipped, kept)
    assert (kept / "a" / "one.nbi").read_text() == "index"
    assert (kept / "own.nbi").read_text() == "own"
    assert not [path for path in kept.rglob(".*") if path.is_file()]


def test_what_was_broken_off_is_done_again(shipped: Path, tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    lay_out(shipped, kept)
    (kept / STAMP).unlink()
    (kept / "a" / "one.nbi").unlink()
    assert lay_out(shipped, kept)
    assert (kept / "a" / "one.nbi").is_file()


def test_without_shipped_kernels_nothing_happens(tmp_path: Path) -> None:
    assert not lay_out(tmp_path / "none", tmp_path / "kept")
    assert not (tmp_path / "kept").exists()


def test_a_folder_that_cannot_be_written_is_told_and_stops_nothing(
    shipped: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "kept").write_text("a file where the folder should be")
    monkeypatch.setenv("SPOTTER_KERNELS", str(shipped))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kept"))
    assert not lay_out_own()
    assert "cannot be laid out" in caplog.text
    assert str(tmp_path / "kept") in caplog.text


USE_ONE = """
import numpy as np
from services.infra_lidar.kernels_returns import beams_seen
from services.infra_lidar.shipped import lay_out_own
laid_out = lay_out_own()
beams_seen(np.zeros((1, 2), np.float32)[:, 0], np.zeros(256, bool))
print(laid_out, sum(beams_seen.stats.cache_hits.values()), sum(beams_seen.stats.cache_misses.values()))
"""


def test_another_machine_does_not_compile_what_was_shipped(tmp_path: Path) -> None:
    def use(kept: str, shipped: str) -> str:
        environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / kept), "SPOTTER_KERNELS": shipped}
        words = [sys.executable, "-c", USE_ONE]
        return subprocess.run(words, env=environment, capture_output=True, text=True, check=True).stdout.strip()

    assert use("shipped", "") == "False 0 1"
    (tmp_path / "shipped" / STAMP).write_text("built elsewhere")
    assert use("kept", str(tmp_path / "shipped")) == "True 1 0"
    assert use("kept", str(tmp_path / "shipped")) == "False 1 0"
    assert use("other", "") == "False 0 1"
