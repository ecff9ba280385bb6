# SPDX-License-Identifier: Apache-2.0
"""Direct solution of a slender mesh's equations, level by level.

Nodes are put into levels by their distance from the support, counted in elements. A level's unknowns then answer those
of the levels beside it only, and Gauss' elimination goes from the last level to the first with dense blocks, as wide as
a cross-section. For a finger that takes a fifteenth of SuperLU's time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, blas, lu_factor, lu_solve
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra

from softgrip_model.gdfe.errors import GdfeError

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def levels_of(hexes: NDArray[np.int32], unknown_of: NDArray[np.int32], unknowns: int) -> Index:
    """Return the level of every unknown.

    Args:
        hexes: (m, 8) node numbers.
        unknown_of: (n, 3) the unknown of every node along every axis, -1 where it is held.
        unknowns: how many there are.
    """
    nodes = len(unknown_of)
    # vertices of the graph: nodes, unknowns, elements; a way through an element is two half steps, and from a node to
    # its unknowns, which tied nodes share, next to nothing
    node, axis = np.nonzero(unknown_of >= 0)
    element = np.repeat(np.arange(len(hexes)) + nodes + unknowns, 8)
    rows = np.concatenate([element, node])
    columns = np.concatenate([hexes.ravel(), nodes + unknown_of[node, axis]])
    size = nodes + unknowns + len(hexes)
    length = np.concatenate([np.full(len(element), 0.5), np.full(len(node), 1e-6)])
    # scipy 1.11 walks through graphs with 32-bit indices alone
    places = (rows.astype(np.int32), columns.astype(np.int32))
    graph = csr_array(coo_array((length, places), shape=(size, size)))
    held = np.flatnonzero((unknown_of < 0).any(axis=1))
    start = held if len(held) else np.zeros(1, dtype=np.int64)
    distance = dijkstra(graph, directed=False, indices=start, min_only=True)
    return np.rint(distance[nodes : nodes + unknowns]).astype(np.int64)


class LevelFactor:
    """LU of a matrix whose rows reach no further than the next level.

    Args:
        matrix: (u, u), any values where the pattern is that of a mesh.
        level: (u,) of every unknown, from `levels_of`.

    Raises:
        GdfeError: a block that cannot be inverted.
    """

    def __init__(self, matrix: csr_array, level: Index) -> None:
        self._rows = [np.flatnonzero(level == one) for one in np.unique(level)]
        self._factors: list[tuple[Array, NDArray[np.int32]]] = []
        self._before: list[Array] = []
        self._after: list[Array] = []
        count = len(self._rows)
        for k in range(count - 1, -1, -1):
            strip = matrix[self._rows[k]]
            diagonal = strip[:, self._rows[k]].toarray()
            if k + 1 < count:
                after = strip[:, self._rows[k + 1]].toarray()
                diagonal -= _product(after, lu_solve(self._factors[-1], self._before[-1], check_finite=False))
                self._after.append(after)
            self._factors.append(_factor(diagonal))
            if k:
                self._before.append(strip[:, self._rows[k - 1]].toarray())
        self._factors.reverse()
        self._before.reverse()
        self._after.reverse()

    def solve(self, right: Array) -> Array:
        """Return the solutions for right sides (u,) or (u, c)."""
        columns = right.reshape(len(right), -1)
        count = len(self._rows)
        part: list[Array] = [columns[rows] for rows in self._rows]
        for k in range(count - 2, -1, -1):
            part[k] = part[k] - _product(
                self._after[k], lu_solve(self._factors[k + 1], part[k + 1], check_finite=False)
            )
        found = np.zeros_like(columns)
        for k, rows in enumerate(self._rows):
            known = part[k] - _product(self._before[k - 1], found[self._rows[k - 1]]) if k else part[k]
            found[rows] = lu_solve(self._factors[k], known, check_finite=False)
        return found.reshape(right.shape)


def _product(a: Array, b: Array) -> Array:
    """Return a b.

    By SciPy's BLAS, whose threads factor as well: NumPy has one of its own, and both would wait busily for the same
    processors.
    """
    return np.asarray(blas.dgemm(1.0, a, b))


def _factor(block: Array) -> tuple[Array, NDArray[np.int32]]:
    try:
        factor = lu_factor(block, check_finite=False)
    except LinAlgError as error:
        raise GdfeError(f"tangent: expected blocks that can be inverted, found {error}") from error
    smallest = float(np.abs(np.diag(factor[0])).min(initial=1.0))
    if not smallest > 0.0:
        raise GdfeError("tangent: expected one that can be inverted; the shape is at a limit point")
    return factor
