"""The service as a process with a source that cannot be: it ends at once, with a sentence, router or not."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

pytestmark = [pytest.mark.patient]


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("file:/no/such/street.pcap", "/no/such/street.pcap does not exist"),
        ("file:{tmp}", "no .npz, .pcd, .bin, .npy, .ply, .las, .laz frames in {tmp}; it holds bad.bag"),
        ("file:{tmp}/bad.bag", "no ROS bag, or a damaged one"),
        ("file:/dev/null/x.laz", "/dev/null/x.laz does not exist"),
        ("", "source"),
    ],
)
def test_a_source_that_is_none_ends_the_service(
    source: str, words: str, tmp_path: Path, free_ports: Callable[[], int]
) -> None:
    (tmp_path / "bad.bag").write_bytes(b"garbage")
    script = str(Path(sys.executable).with_name("spotter-infra-lidar"))
    done = subprocess.run(
        [script, "--source", source.format(tmp=tmp_path), "--set", f'zenoh.connect=["tcp/127.0.0.1:{free_ports()}"]'],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert words.format(tmp=tmp_path) in done.stderr
    assert "Traceback" not in done.stderr
