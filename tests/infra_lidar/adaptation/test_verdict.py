"""When a site's forest is refused, and in which words."""

import numpy as np
import pytest

from services.infra_lidar.adaptation.verdict import Figures, HeldOut, judge, objections

EVERY = np.full(5, 0.9)
BEFORE = Figures(right=0.80, false=10.0, recall=EVERY)
ENOUGH = HeldOut(np.zeros((20, 1), np.float32), np.repeat([0, 1], 10), np.arange(20), 5)


def _pedestrian(recall):
    return np.array([0.9, 0.9, 0.9, 0.9, recall])


@pytest.mark.parametrize(
    ("after", "says"),
    [
        (Figures(0.85, 4.0, EVERY), ""),
        (Figures(0.80, 4.0, EVERY), ""),
        (Figures(0.90, 10.0, EVERY), ""),
        (Figures(0.80, 10.0, EVERY), "no better"),
        (Figures(0.75, 1.0, EVERY), "called right fall from 80.0% to 75.0%"),
        (Figures(0.95, 10.5, EVERY), "rise from 10.00 to 10.50"),
        (Figures(0.85, 4.0, _pedestrian(0.8)), "pedestrian on generated streets falls from 90.0% to 80.0%"),
        (Figures(0.85, 4.0, _pedestrian(np.nan)), ""),
    ],
)
def test_accepted_only_when_better(after, says):
    found = "; ".join(objections(BEFORE, after, ENOUGH))
    assert says in found
    assert bool(says) == bool(found)


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        ((0.80, 0.0), (0.80, 0.0), "no better"),
        ((0.80, 0.0), (0.81, 0.0), "no better"),
        ((1.00, 0.0), (1.00, 0.0), "no better"),
        ((0.80, 0.0), (0.83, 0.0), ""),
        ((0.80, 10.0), (0.80, 9.9), "no better"),
        ((0.80, 10.0), (0.80, 9.8), ""),
        ((0.80, 0.1), (0.80, 0.0), ""),
    ],
)
def test_one_of_both_figures_must_be_better_by_two_percent(before, after, says):
    found = "; ".join(objections(Figures(*before, EVERY), Figures(*after, EVERY), ENOUGH))
    assert says in found
    assert bool(says) == bool(found)


def test_too_few_road_users_are_too_few():
    few = ENOUGH._replace(labels=np.zeros(20, int))
    assert "0 road users moved" in next(objections(BEFORE, Figures(1.0, 0.0, EVERY), few))


def test_each_road_user_counts_once_and_false_ones_are_per_picture():
    labels, groups = np.array([1, 1, 1, 1, 2, 0, 0, 0]), np.array([0, 0, 0, 0, 1, 2, 2, 3])
    said = np.array([1, 1, 1, 1, 1, 2, 5, 0])  # four right of the first, none of the second; one of three false
    held_out = HeldOut(np.zeros((8, 1), np.float32), labels, groups, 2)
    figures = judge(said, held_out, np.array([1, 1, 4]), np.array([1, 1, 1]))
    assert figures.right == 0.5
    assert figures.false == 0.5
    assert figures.recall[1] == pytest.approx(2 / 3)
    assert np.isnan(figures.recall[4])
