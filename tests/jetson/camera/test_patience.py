"""How long a capture child may be silent: longer for a camera that has shown to be slow."""

from __future__ import annotations

import pytest

from services.jetson.camera.capture import QUICK_PICTURES, Patience
from services.jetson.camera.child import CaptureChild, CaptureLost
from services.jetson.camera.config import CaptureConfig


def test_patience_grows_for_the_slow_and_shrinks_for_the_quick() -> None:
    patience = Patience(CaptureConfig(frame_timeout_s=0.5, start_timeout_s=3.0))
    patience.started()
    assert not patience.silent()  # nothing came at all: that is no slowness
    given_s = []
    for _ in range(5):
        patience.started()
        patience.picture(0.2)
        assert patience.silent()
        given_s.append(patience.timeout_s)
    assert given_s == [1.0, 2.0, 3.0, 3.0, 3.0]
    for _ in range(QUICK_PICTURES - 2):  # and the one before
        patience.picture(0.03)
    assert patience.timeout_s == 3.0
    patience.picture(0.03)
    assert patience.timeout_s == 0.5
    assert not patience.silent()  # many pictures, then silence: it hangs


def test_a_child_that_leaves_another_process_behind_has_ended_all_the_same() -> None:
    """What it started holds its stderr open: the end of the child is told, and not the end of the service."""
    command = ["sh", "-c", "sleep 2 > /dev/null & exit 3"]
    with CaptureChild(command, 64, 48) as child, pytest.raises(CaptureLost, match="ended with code 3"):
        child.read(5.0)
