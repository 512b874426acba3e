"""A notebook in a folder that has a package ``common`` of its own: both are usable, whichever is imported first."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from common import topics
from common.bus.runtime import Service
from common.config import ServiceConfig, ZenohConfig
from common.messages import RadarTracks

REPOSITORY = Path(__file__).parents[2]
READ_THEIRS = "import common.config as theirs; assert theirs.MINE == 'a notebook'"
READ_OURS = """
import spotter_client
with spotter_client.connect(sys.argv[1]) as bus:
    print(bus.latest("pi0/radar/tracks", spotter_client.RadarTracks, timeout_s=20).noise_floor_db)
    print([service.name for service in bus.services()])
"""


@pytest.fixture
def notebook(tmp_path: Path) -> Path:
    for package in ("common", "services"):
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").write_text("")
    (tmp_path / "common" / "config.py").write_text("MINE = 'a notebook'\n")
    (tmp_path / "common" / "codec.py").write_text("raise RuntimeError('this is not the codec')\n")
    return tmp_path


@pytest.mark.parametrize("cells", [(READ_THEIRS, READ_OURS, READ_THEIRS), (READ_OURS, READ_THEIRS, READ_OURS)])
def test_both_packages_are_usable(zenoh_config: ZenohConfig, notebook: Path, cells: tuple[str, ...]) -> None:
    script = notebook / "cells.py"
    script.write_text("\n".join(("import sys", *cells)))
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    with Service("radar", ServiceConfig(host="pi0", zenoh=zenoh_config)) as radar:
        publish = radar.publisher(topics.RADAR_TRACKS)
        process = subprocess.Popen(
            [sys.executable, str(script), zenoh_config.connect[0]],
            cwd=notebook, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        while process.poll() is None:
            publish(RadarTracks(stamp_ns=1, tracks=[], level="SAFE", settled=True, noise_floor_db=-60.0))
            radar.wake.wait(0.02)
        said, error_text = process.communicate()
    assert process.returncode == 0, error_text
    assert said.splitlines()[:2] == ["-60.0", "['radar']"]


def test_without_another_package_nothing_is_changed() -> None:
    check = "import sys, common, spotter_client, common.codec; assert spotter_client.Verdict.__module__ in sys.modules"
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    subprocess.run([sys.executable, "-c", check], env=environment, check=True, timeout=60)
