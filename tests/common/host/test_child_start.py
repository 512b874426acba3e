"""A child that cannot be started is no reason to end the others."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from common.host.supervisor import Supervisor
from tests.common.host.test_supervisor import SLEEPER, python, until

pytestmark = pytest.mark.system


def test_a_child_whose_folder_is_gone_is_tried_again_and_the_others_are_left_alone(tmp_path: Path) -> None:
    lines: list[str] = []
    folder = tmp_path / "gone"
    lost, spared = python("lost", SLEEPER), python("spared", SLEEPER)
    lost.folder = str(folder)

    async def scenario() -> int:
        supervisor = Supervisor([lost, spared], write=lines.append)
        running = asyncio.create_task(supervisor.run())
        await until(lambda: running.done() or any("starting it again" in line for line in lines))
        folder.mkdir()
        await until(lambda: running.done() or sum("up" in line for line in lines) == 2)
        assert spared.starts == lost.starts == 1
        supervisor.stop()
        return await running

    assert asyncio.run(scenario()) == 0
    assert f"lost   | cannot be started: {folder}: No such file or directory\n" in lines
