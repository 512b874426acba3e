"""Folders with several kinds of files, and columns that are asked for where the file names its own."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest

from common.bus.status import Report
from common.config import ConfigError
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.input.look_recordings import describe_recording
from services.infra_lidar.input.point_files import others_beside
from services.infra_lidar.input.source import open_source
from tests.infra_lidar.made_frames import ROWS, npz, pcd, text


@pytest.fixture
def mixed(tmp_path: Path) -> Path:
    (tmp_path / "a.pcd").write_bytes(pcd("ascii", text()))
    for name in ("b.bin", "c.BIN", "d.npy"):
        (tmp_path / name).write_bytes(ROWS.tobytes())
    for name in ("background.npz", "notes.txt"):
        (tmp_path / name).write_bytes(b"")
    return tmp_path


def test_look_and_the_source_name_what_is_not_read(mixed: Path, caplog: pytest.LogCaptureFixture) -> None:
    lines = [line for line, _ in describe_recording(mixed)]
    assert f"1 frames .pcd in {mixed}; not read: 2 .bin, 1 .npy, as a source has one kind of files" in lines
    with caplog.at_level(logging.WARNING):
        frames = list(open_source(InfraLidarConfig(source=f"file:{mixed}?rate=0"), Report("test")))
    assert len(frames) == 1
    assert "1 frames .pcd are read, not 2 .bin, 1 .npy" in caplog.text


def test_nothing_is_said_of_one_kind_of_files(tmp_path: Path) -> None:
    for name in ("a.npz", "b.npz", "background.npz"):
        (tmp_path / name).write_bytes(npz(xyz=ROWS[:, :3]))
    assert others_beside(tmp_path, ".npz") == ""
    assert f"2 frames .npz in {tmp_path}" in [line for line, _ in describe_recording(tmp_path)]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("a.pcd", r"columns= is for \.bin and \.npy, not for \.pcd"),
        ("", r"columns= is for \.bin and \.npy, not for \.pcd"),
        ("a.pcap", r"columns= is for \.bin and \.npy, not for \.pcap"),
    ],
)
def test_columns_of_a_file_that_names_its_own_are_refused(mixed: Path, name: str, words: str) -> None:
    (mixed / "a.pcap").write_bytes(b"no capture")
    with pytest.raises(ConfigError, match=words):
        open_source(InfraLidarConfig(source=f"file:{mixed / name}?columns=x,y,z"), Report("test"))


def test_columns_of_a_bin_are_taken(mixed: Path) -> None:
    np.random.default_rng(0).uniform(1, 9, (8, 4)).astype(np.float32).tofile(mixed / "b.bin")
    source = f"file:{mixed / 'b.bin'}?rate=0&columns=x,y,z,time"
    ((_, frame),) = open_source(InfraLidarConfig(source=source), Report("test"))
    assert frame.points.shape == (8, 3)
