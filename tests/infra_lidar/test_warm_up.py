"""What is warmed up before the first real frame, so that none has to wait for a kernel."""

from services.infra_lidar import warm_up
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.kernels_background import put_back
from services.infra_lidar.kernels_ground import count_cells
from services.infra_lidar.tracking import MultiObjectTracker


def test_the_people_of_the_warm_up_end_in_one_cluster_that_is_cut():
    tracker = MultiObjectTracker(InfraLidarConfig().tracking)
    warm_up.follow_people(tracker)
    assert [track.state for track in tracker.messages()] == ["confirmed", "confirmed"]
    assert list(tracker.matches.values()) == [0, 0]


def test_a_warm_start_has_run_what_comes_seldom():
    told: list[str] = []
    warm_up.warm_up(InfraLidarConfig(), told.append)
    assert len(told) == 1
    assert "kernels" in told[0]
    assert put_back.signatures  # frames after the end of learning
    assert count_cells.signatures  # the watch over the pole
