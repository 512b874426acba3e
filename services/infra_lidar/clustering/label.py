"""Connected components of occupied bird's-eye-view cells: union-find over the occupied cells.

Every occupied cell is a node and joins its occupied neighbours. The grid is kept between frames, and only cells that
were used are cleared, so time is linear in the points and independent of the size of the grid.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from services.infra_lidar.clustering.grid import CellScale, cells_of
from services.infra_lidar.clustering.merge_vehicles import WHOLE_CAR_TOP_M
from services.infra_lidar.config import ClusteringConfig
from services.infra_lidar.jit import kernel

BAND_M = np.float32(0.4)  # a component with points in this uppermost part of the body height continues above it
TALL_SHARE = 0.03  # of its points
TALL_POINTS = 3
CAR_TOP_M = np.float32(WHOLE_CAR_TOP_M)
BRANCH_M = np.float32(1.0)  # branches have nothing lower
STRAY_SHARE = 0.01  # of a component's points at most are strays
STRAY_GAP_M = np.float32(0.4)  # and at least this far above all others
LAYER_M, LAYERS = np.float32(0.1), 64  # heights are counted in layers of this thickness


class Cells(NamedTuple):
    """The C cells of the grid that M points lie in, in the order of the points.

    place: (C,) int32, row * side + column in the grid. of_point: (M,) int32, the cell of each point, 0..C-1. low, band:
    (C,) int32, number of points below the height of a body, and of those in its uppermost ``BAND_M``. bottom_m, top_m:
    (C,) float32, height of the lowest and of the highest point above the local road.
    """

    place: np.ndarray
    of_point: np.ndarray
    low: np.ndarray
    band: np.ndarray
    bottom_m: np.ndarray
    top_m: np.ndarray


class LabelRules(NamedTuple):
    """``ClusteringConfig`` as the kernels take it: heights above the local road in m, float32.

    body_m: points below this height occupy cells, inf = all do. most_m: height of the highest vehicle. eight: cells
    that touch at a corner are neighbours, too.
    """

    min_cell_points: int
    eight: bool
    body_m: np.float32
    most_m: np.float32


def label_rules(config: ClusteringConfig) -> LabelRules:
    """The rules in a configuration."""
    body_m, most_m = np.float32(config.body_height_m or np.inf), np.float32(config.max_height_m)
    return LabelRules(config.min_cell_points, config.connectivity == 8, body_m, most_m)


@kernel
def label_points(points: np.ndarray, grid: CellScale, rules: LabelRules, cell_at: np.ndarray) -> np.ndarray:
    """Component of each point, (M,) int32, 0..K-1, -1 = none.

    points: (M, 4) float32 as in ``Obstacles``. cell_at: (side * side,) int32 scratch, -1 before and after.
    """
    place, above_m, all_heights = cells_of(points, grid), points[:, 3].copy(), np.float32(np.inf)
    cells, component, number = _components(place, above_m, rules.body_m, grid, rules, cell_at)
    label = component[cells.of_point]
    if rules.body_m == all_heights:
        return label
    tall, higher = _tall_and_higher(cells, component, number, rules.most_m)
    for apart in _points_apart(cells, above_m, tall, higher, rules.body_m):  # each has components of its own
        cells, component, more = _components(place[apart], above_m[apart], all_heights, grid, rules, cell_at)
        for i in range(len(apart)):
            k = component[cells.of_point[i]]
            label[apart[i]] = number + k if k >= 0 else -1
        number += more
    _drop_strays(above_m, label, number)
    return label


@kernel
def _components(
    place: np.ndarray, above_m: np.ndarray, body_m: np.float32, grid: CellScale, rules: LabelRules, cell_at: np.ndarray
) -> tuple[Cells, np.ndarray, int]:
    """The cells of the points, the component of each cell (C,) int32, 0..K-1, -1 = it is not occupied, and K."""
    cells = _list_cells(place, above_m, body_m, cell_at)
    occupied = cells.low >= rules.min_cell_points
    component, number = _join_cells(cells.place, occupied, grid.side, rules.eight, cell_at)
    for at in cells.place:
        cell_at[at] = -1
    return cells, component, number


@kernel
def _list_cells(place: np.ndarray, above_m: np.ndarray, body_m: np.float32, cell_at: np.ndarray) -> Cells:
    """``Cells`` of the points; cell_at: (side * side,) int32 is -1 everywhere and receives the number of each cell."""
    n, number = len(place), 0
    where, of_point = np.empty(n, np.int32), np.empty(n, np.int32)
    for i in range(n):
        at = np.uint32(place[i])
        if cell_at[at] < 0:
            cell_at[at], where[number] = number, place[i]
            number += 1
        of_point[i] = cell_at[at]
    low, band = np.zeros(number, np.int32), np.zeros(number, np.int32)
    bottom_m, top_m = np.full(number, np.inf, np.float32), np.full(number, -np.inf, np.float32)
    band_m = body_m - BAND_M
    for i in range(n):
        cell, height = np.uint32(of_point[i]), above_m[i]
        low[cell] += height < body_m
        band[cell] += (height >= band_m) & (height < body_m)
        bottom_m[cell], top_m[cell] = min(bottom_m[cell], height), max(top_m[cell], height)
    return Cells(where[:number], of_point, low, band, bottom_m, top_m)


@kernel
def _root(parent: np.ndarray, node: int) -> int:
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node


@kernel
def _join_cells(
    place: np.ndarray, occupied: np.ndarray, side: int, eight: bool, cell_at: np.ndarray
) -> tuple[np.ndarray, int]:
    """Component (C,) int32 of each cell, -1 where it is not ``occupied`` (C,) bool; and the number of components.

    eight: cells that touch at a corner are neighbours, too.
    """
    parent = np.arange(len(place)).astype(np.int32)
    steps = np.array([1, side, side - 1, side + 1])  # right, below, below left, below right
    for cell in range(len(place)):
        if not occupied[cell]:
            continue
        column = place[cell] % side
        for k in range(4 if eight else 2):
            beyond_left, beyond_right = k == 2 and column == 0, (k == 0 or k == 3) and column == side - 1
            beside = place[cell] + steps[k]
            if beyond_left or beyond_right or beside >= len(cell_at):
                continue
            other = cell_at[beside]
            if other >= 0 and occupied[other]:
                a, b = _root(parent, cell), _root(parent, other)
                parent[max(a, b)] = min(a, b)
    component, number = np.full(len(place), -1, np.int32), 0
    for cell in range(len(place)):  # a root is the smallest cell of its component, so it comes first
        if not occupied[cell]:
            continue
        root = _root(parent, cell)
        if root == cell:
            component[cell] = number
            number += 1
        else:
            component[cell] = component[root]
    return component, number


@kernel
def _tall_and_higher(
    cells: Cells, component: np.ndarray, number: int, most_m: np.float32
) -> tuple[np.ndarray, np.ndarray]:
    """(C,) bool: cells of components whose points reach the top of the body height and end below ``most_m``; and those
    of components that are higher. component: (C,) int32, of ``number`` components."""
    low, band, top_m = np.zeros(number, np.int32), np.zeros(number, np.int32), np.zeros(number, np.float32)
    for cell in range(len(component)):
        k = component[cell]
        if k >= 0:
            low[k] += cells.low[cell]
            band[k] += cells.band[cell]
            top_m[k] = max(top_m[k], cells.top_m[cell])
    reaches_up = (band >= TALL_POINTS) & (band >= TALL_SHARE * low)
    tall, higher = np.zeros(len(component), np.bool_), np.zeros(len(component), np.bool_)
    for cell in range(len(component)):
        k = component[cell]
        tall[cell] = k >= 0 and reaches_up[k] and top_m[k] <= most_m
        higher[cell] = k >= 0 and top_m[k] > most_m
    return tall, higher


@kernel
def _points_apart(
    cells: Cells, above_m: np.ndarray, tall: np.ndarray, higher: np.ndarray, body_m: np.float32
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Index (int32) of the points that form components of their own: feet, roofs and overhang.

    What is higher than any vehicle is a tree, a post or a house, and its foot is what stands on the road. A car there
    touches it through branches: cells in which nothing is near the road and something is above body height. What is no
    higher in these than a car may be the roof of one below them; it is merged with its car again. What is above body
    height hangs over the road, unless it is part of something tall.

    tall, higher: (C,) bool as by ``_tall_and_higher``.
    """
    n, feet, roofs, number = len(above_m), 0, 0, 0
    foot, roof, overhang = np.empty(n, np.int32), np.empty(n, np.int32), np.empty(n, np.int32)
    in_branches = (cells.bottom_m >= BRANCH_M) & (cells.top_m >= body_m)
    for i in range(n):
        cell = cells.of_point[i]
        if above_m[i] >= body_m:
            if not tall[cell]:
                overhang[number] = i
                number += 1
        elif higher[cell] and not in_branches[cell]:
            foot[feet] = i
            feet += 1
        elif higher[cell] and above_m[i] < CAR_TOP_M:
            roof[roofs] = i
            roofs += 1
    return foot[:feet], roof[:roofs], overhang[:number]


@kernel
def _drop_strays(above_m: np.ndarray, label: np.ndarray, components: int) -> None:
    """Write -1 to the label of the few returns that hang above all others of their component.

    Leaves over a car, birds and mixed pixels: three of them above 875 returns made a car higher than cars are.

    above_m: (M,) float32, height above the local road. label: (M,) int32, component of each point, -1 = none.
    """
    n, last, per_m = len(label), np.int32(LAYERS - 1), np.float32(1.0 / LAYER_M)
    count, bin_of_point = np.zeros((components + 1, LAYERS), np.int32), np.empty(n, np.int32)  # row 0: of no component
    for i in range(n):
        layer = min(max(np.int32(above_m[i] * per_m), np.int32(0)), last)
        bin_of_point[i] = (label[i] + np.int32(1)) * np.int32(LAYERS) + layer
    flat, limit_m = count.reshape(-1), np.full(components + 1, np.inf, np.float32)
    for b in bin_of_point:
        flat[np.uint32(b)] += 1
    for row in range(1, components + 1):
        strays = int(count[row].sum() * STRAY_SHARE)
        if strays > 0:
            limit_m[row] = _top_of_body(count[row], strays) + STRAY_GAP_M
    for i in range(n):
        if above_m[i] > limit_m[np.uint32(label[i] + 1)]:
            label[i] = -1


@kernel
def _top_of_body(count: np.ndarray, strays: int) -> np.float32:
    """Upper end (m) of the highest layer that has more than ``strays`` points in it and above; count: (LAYERS,)."""
    layer, above = len(count) - 1, count[-1]
    while above <= strays and layer > 0:
        layer -= 1
        above += count[layer]
    return LAYER_M * np.float32(layer + 1) if layer < len(count) - 1 else np.float32(np.inf)
