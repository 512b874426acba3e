"""Connected components of occupied bird's-eye-view cells: union-find over the occupied cells.

Every occupied cell is a node and joins its occupied neighbours. The grid is kept between frames, and only cells that
were used are cleared, so time is linear in the points and independent of the size of the grid.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.clustering.grid import CellGrid
from services.infra_lidar.clustering.merge_vehicles import WHOLE_CAR_TOP_M
from services.infra_lidar.config import ClusteringConfig
from services.infra_lidar.jit import kernel

BAND_M = np.float32(0.4)  # a component with points in this uppermost part of the body height continues above it
TALL_SHARE = 0.03  # of its points
TALL_POINTS = 3
CAR_TOP_M = np.float32(WHOLE_CAR_TOP_M)
BRANCH_M = np.float32(1.0)  # branches have nothing lower
LOW, HIGH = 1, 2  # what a cell has: points near the road, points above body height
STRAY_SHARE = 0.01  # of a component's points at most are strays
STRAY_GAP_M = np.float32(0.4)  # and at least this far above all others
LAYER_M, LAYERS = np.float32(0.1), 64  # heights are counted in layers of this thickness


class CellLabeller:
    """Labels the points of one sensor's frames by connected component. Holds the grid: one thread at a time."""

    def __init__(self, config: ClusteringConfig, grid: CellGrid) -> None:
        self._grid, self._min_cell_points, self._eight = grid, config.min_cell_points, config.connectivity == 8
        self._node_of_cell = np.full(grid.side * grid.side, -1, np.int32)
        self._reach = np.zeros(grid.side * grid.side, np.uint8)

    def label(self, cell: np.ndarray, fills: np.ndarray) -> tuple[np.ndarray, int]:
        """Component of each point.

        cell: (M,) int32, as by ``cells_of``. fills: (M,) bool, the points that occupy cells; the others only take the
        label of the cell that they lie in. Returns (M,) int32 labels 0..K-1, -1 = the cell is not occupied; and K.
        """
        cells, count = occupy(cell, fills, self._node_of_cell)
        components, number = join_cells(
            cells, count >= self._min_cell_points, self._node_of_cell, self._grid.side, self._eight
        )
        label = labels_of_points(cell, self._node_of_cell, components)
        self._node_of_cell[cells] = -1
        return label, number

    def extract_foot(
        self, cell: np.ndarray, above_m: np.ndarray, label: np.ndarray, higher: np.ndarray, body_m: np.float32
    ) -> tuple[np.ndarray, np.ndarray]:
        """Index (int32) of points in ``higher`` (K,) bool components: what stands on the road, and what may be a roof.

        What is higher than any vehicle is a tree, a post or a house. A car at its foot touches it through branches:
        cells in which nothing is near the road and something is above body height. What is no higher there than a car
        may be the roof of one below the branches; it is merged with its car again.
        """
        return _points_at_foot(above_m, label, higher, _in_branches(cell, above_m, body_m, self._reach), body_m)


@kernel
def occupy(cell: np.ndarray, fills: np.ndarray, node_of_cell: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cells (C,) int32 with a point that fills, in the order of the points, and how many such points each has (C,).

    node_of_cell is -1 everywhere and receives the place of each of these cells in the list.
    """
    cells, count, nodes = np.empty(len(cell), np.int32), np.zeros(len(cell), np.int32), 0
    for i in range(len(cell)):
        if not fills[i]:
            continue
        node = node_of_cell[cell[i]]
        if node < 0:
            node = nodes
            node_of_cell[cell[i]] = node
            cells[node] = cell[i]
            nodes += 1
        count[node] += 1
    return cells[:nodes], count[:nodes]


@kernel
def _root(parent: np.ndarray, node: int) -> int:
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node


@kernel
def join_cells(
    cells: np.ndarray, occupied: np.ndarray, node_of_cell: np.ndarray, side: int, eight: bool
) -> tuple[np.ndarray, int]:
    """Component (C,) int32 of each cell, -1 where it is not ``occupied`` (C,) bool; and the number of components.

    eight: cells that touch at a corner are neighbours, too.
    """
    parent = np.arange(len(cells)).astype(np.int32)
    steps = np.array([1, side, side - 1, side + 1])  # right, below, below left, below right
    for node in range(len(cells)):
        if not occupied[node]:
            continue
        column = cells[node] % side
        for k in range(4 if eight else 2):
            beyond_left, beyond_right = k == 2 and column == 0, (k == 0 or k == 3) and column == side - 1
            place = cells[node] + steps[k]
            if beyond_left or beyond_right or place >= len(node_of_cell):
                continue
            other = node_of_cell[place]
            if other >= 0 and occupied[other]:
                a, b = _root(parent, node), _root(parent, other)
                parent[max(a, b)] = min(a, b)
    component, number = np.full(len(cells), -1, np.int32), 0
    for node in range(len(cells)):  # a root is the smallest node of its component, so it comes first
        if not occupied[node]:
            continue
        root = _root(parent, node)
        if root == node:
            component[node] = number
            number += 1
        else:
            component[node] = component[root]
    return component, number


@kernel
def labels_of_points(cell: np.ndarray, node_of_cell: np.ndarray, component: np.ndarray) -> np.ndarray:
    """(M,) int32: the component of each point's cell, -1 = none."""
    label = np.empty(len(cell), np.int32)
    for i in range(len(cell)):
        node = node_of_cell[cell[i]]
        label[i] = component[node] if node >= 0 else -1
    return label


@kernel
def component_tops(above_m: np.ndarray, label: np.ndarray, components: int) -> np.ndarray:
    """(K,) float32, height (m) of the highest point of each component, 0 at least.

    above_m: (M,) float32, height above the local road. label: (M,) int32, component of each point, -1 = none.
    """
    top_m = np.zeros(components, np.float32)
    for i in range(len(label)):
        if label[i] >= 0:
            top_m[label[i]] = max(top_m[label[i]], above_m[i])
    return top_m


@kernel
def tall_components(
    above_m: np.ndarray, label: np.ndarray, top_m: np.ndarray, body_m: np.float32, most_m: np.float32
) -> np.ndarray:
    """(K,) bool: components whose points reach the top of the body height, and end below ``most_m``.

    top_m: (K,) as by ``component_tops``, the others as there.
    """
    number, in_band = np.zeros(len(top_m), np.int32), np.zeros(len(top_m), np.int32)
    for i in range(len(label)):
        if label[i] >= 0 and above_m[i] < body_m:
            number[label[i]] += 1
            in_band[label[i]] += above_m[i] >= body_m - BAND_M
    return (in_band >= TALL_POINTS) & (in_band >= TALL_SHARE * number) & (top_m <= most_m)


@kernel
def _in_branches(cell: np.ndarray, above_m: np.ndarray, body_m: np.float32, reach: np.ndarray) -> np.ndarray:
    """(M,) bool: points in cells that hold branches. reach: (cells of the grid,) uint8, 0 before and after."""
    for i in range(len(cell)):
        if above_m[i] < BRANCH_M:
            reach[cell[i]] |= LOW
        elif above_m[i] >= body_m:
            reach[cell[i]] |= HIGH
    found = np.empty(len(cell), np.bool_)
    for i in range(len(cell)):
        found[i] = reach[cell[i]] == HIGH
    for i in range(len(cell)):
        reach[cell[i]] = 0
    return found


@kernel
def _points_at_foot(
    above_m: np.ndarray, label: np.ndarray, higher: np.ndarray, in_branches: np.ndarray, body_m: np.float32
) -> tuple[np.ndarray, np.ndarray]:
    foot, roof = np.empty(len(label), np.int32), np.empty(len(label), np.int32)
    feet = roofs = 0
    for i in range(len(label)):
        if above_m[i] >= body_m or label[i] < 0 or not higher[label[i]]:
            continue
        if not in_branches[i]:
            foot[feet] = i
            feet += 1
        elif above_m[i] < CAR_TOP_M:
            roof[roofs] = i
            roofs += 1
    return foot[:feet], roof[:roofs]


@kernel
def extract_overhang(above_m: np.ndarray, label: np.ndarray, tall: np.ndarray, body_m: np.float32) -> np.ndarray:
    """(H,) int32: index of the points above body height that do not belong to a ``tall`` (K,) bool component."""
    overhang, number = np.empty(len(label), np.int32), 0
    for i in range(len(label)):
        if above_m[i] >= body_m and (label[i] < 0 or not tall[label[i]]):
            overhang[number] = i
            number += 1
    return overhang[:number]


@kernel
def drop_strays(above_m: np.ndarray, label: np.ndarray, components: int) -> None:
    """Write -1 to the label of the few returns that hang above all others of their component.

    Leaves over a car, birds and mixed pixels: three of them above 875 returns made a car higher than cars are.

    above_m: (M,) float32, height above the local road. label: (M,) int32, component of each point, -1 = none.
    """
    number, row, rows = np.zeros(components, np.int32), np.full(components, -1, np.int32), 0
    for k in label:
        if k >= 0:
            number[k] += 1
    for k in range(components):
        if number[k] * STRAY_SHARE >= 1.0:
            row[k], rows = rows, rows + 1
    count, limit_m = _layer_counts(above_m, label, row, rows), np.full(components, np.inf, np.float32)
    for k in range(components):
        if row[k] >= 0:
            limit_m[k] = _top_of_body(count[row[k]], int(number[k] * STRAY_SHARE)) + STRAY_GAP_M
    for i in range(len(label)):
        if label[i] >= 0 and above_m[i] > limit_m[label[i]]:
            label[i] = -1


@kernel
def _layer_counts(above_m: np.ndarray, label: np.ndarray, row: np.ndarray, rows: int) -> np.ndarray:
    """(rows, LAYERS) int32: points in each layer of the components with a row; row: (K,) int32, -1 = none."""
    count = np.zeros((rows, LAYERS), np.int32)
    for i in range(len(label)):
        if label[i] >= 0 and row[label[i]] >= 0:
            count[row[label[i]], min(max(int(above_m[i] / LAYER_M), 0), LAYERS - 1)] += 1
    return count


@kernel
def _top_of_body(count: np.ndarray, strays: int) -> np.float32:
    """Upper end (m) of the highest layer that has more than ``strays`` points in it and above; count: (LAYERS,)."""
    layer, above = len(count) - 1, count[-1]
    while above <= strays and layer > 0:
        layer -= 1
        above += count[layer]
    return LAYER_M * np.float32(layer + 1) if layer < len(count) - 1 else np.float32(np.inf)
