"""The floor as a graph: sixteen moves from each cell, and the least cost from everywhere to one cell.

The structure is built once for a shape of grid; a search only writes new weights. All of it is float64: in float32
large costs swallow small ones. Imports numpy and scipy only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from revnm_client.geometry import FloatArray

Cell = tuple[int, int]

FAR = 1e7
"""A cost that no way has."""

_RIM = 2  # no move leads farther, so that no move leaves the padded grid
_HALF: tuple[tuple[Cell, tuple[Cell, ...]], ...] = (
    # A move, and the cells between its ends that it passes; the other eight moves are these, backwards.
    ((0, 1), ()),
    ((1, 0), ()),
    ((1, 1), ((0, 1), (1, 0))),
    ((1, -1), ((0, -1), (1, 0))),
    ((1, 2), ((0, 1), (1, 1))),
    ((1, -2), ((0, -1), (1, -1))),
    ((2, 1), ((1, 0), (1, 1))),
    ((2, -1), ((1, 0), (1, -1))),
)


@dataclass(frozen=True, slots=True)
class CostToCell:
    """The cost of going to one cell.

    Attributes:
        potential: (Ny, Nx) least cost to the cell, in cells of cost 1; inf where there is no way.
        onward: (Ny + 4, Nx + 4) int32, the next node of the padded grid, negative where there is none.
    """

    potential: FloatArray
    onward: NDArray[np.int32]

    def cells_from(self, start: Cell) -> NDArray[np.int64]:
        """Return the cells (P, 2) (row, column) of the way from a cell of finite potential, both ends included."""
        width = self.onward.shape[1]
        following = self.onward.ravel()
        node = (start[0] + _RIM) * width + start[1] + _RIM
        nodes = []
        while node >= 0:
            nodes.append(node)
            node = int(following[node])
        return np.stack(np.divmod(np.array(nodes), width), axis=1) - _RIM


class FloorGraph:
    """The moves on grids of one shape."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self.shape = shape
        self._padded = (shape[0] + 2 * _RIM, shape[1] + 2 * _RIM)
        nodes, width = math.prod(self._padded), self._padded[1]
        moves = [move for move, _ in _HALF] + [(-rows, -columns) for (rows, columns), _ in _HALF]
        steps = np.array([rows * width + columns for rows, columns in moves], dtype=np.int32)
        ends = np.arange(nodes, dtype=np.int32)[:, None] + steps
        # Moves out of the rim are closed by its weights; their ends need only be nodes.
        np.clip(ends, 0, nodes - 1, out=ends)
        self._weights = np.full((nodes, len(moves)), np.inf)
        starts = np.arange(0, ends.size + 1, len(moves), dtype=np.int32)
        self._graph = csr_array((self._weights.ravel(), ends.ravel(), starts), shape=(nodes, nodes))

    def to_cell(self, cost: FloatArray, goal: Cell, *, limit: float = FAR) -> CostToCell:
        """Search the least cost from everywhere to a cell.

        Args:
            cost: (Ny, Nx) float64, positive, of crossing a cell; inf where no way may go. No move cuts the corner of
                such a cell.
            goal: (row, column).
            limit: Cells from where it costs more are left out. Finite: else closed cells would be searched too.
        """
        self._weigh(cost)
        node = (goal[0] + _RIM) * self._padded[1] + goal[1] + _RIM
        least, onward = dijkstra(self._graph, indices=node, return_predecessors=True, limit=limit)
        inner = least.reshape(self._padded)[_RIM:-_RIM, _RIM:-_RIM]
        return CostToCell(inner, onward.reshape(self._padded))

    def _weigh(self, cost: FloatArray) -> None:
        """Write the weight of each move: its length times the mean cost of the cells that it touches."""
        nodes, width = len(self._weights), self._padded[1]
        margin = _RIM * width + _RIM
        flat = np.full(nodes + 2 * margin, np.inf)
        flat[margin:-margin].reshape(self._padded)[_RIM:-_RIM, _RIM:-_RIM] = cost
        here = flat[margin:-margin]
        for k, (move, between) in enumerate(_HALF):
            total = here.copy()
            for rows, columns in (move, *between):
                begin = margin + rows * width + columns
                total += flat[begin : begin + nodes]
            total *= math.hypot(*move) / (2 + len(between))
            self._weights[:, k] = total
            shift = move[0] * width + move[1]
            self._weights[shift:, k + len(_HALF)] = total[:-shift]
