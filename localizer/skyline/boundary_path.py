"""The boundary between sky and terrain of minimum cost, one row per column, by dynamic programming (min-marginals).

With a boundary at row r of a column, pixels 0..r-1 are sky and pixels r.. are terrain. r = 0 is a column without sky, r =
height one without terrain. From one column to the next the boundary may move any number of rows. Each vertical pixel side
along the way has its own cost, which is small at a visible edge, so that cliffs are possible.
"""

import numpy as np
from numpy.typing import NDArray

from localizer.jit import kernel


@kernel()
def _spread(cost: NDArray[np.float32], step: NDArray[np.float32]) -> None:
    """Lower each entry of `cost` to the minimum over paths from other rows; step[r] is the cost of r <-> r + 1."""
    n = cost.size
    for r in range(1, n):
        cost[r] = min(cost[r], cost[r - 1] + step[r - 1])
    for r in range(n - 2, -1, -1):
        cost[r] = min(cost[r], cost[r + 1] + step[r])


@kernel()
def min_marginals(unary: NDArray[np.float32], step: NDArray[np.float32]) -> NDArray[np.float32]:
    """Cost of the best whole boundary through each (column, row).

    Args:
        unary: (width, height + 1), cost of the boundary lying at this row in this column.
        step: (width - 1, height), cost of the boundary running down the side between column i and i + 1 at this row.

    Returns:
        (width, height + 1): the minimum over all boundaries through that point. The argmin of each column is the best
        boundary; the margin of the other rows measures its certainty.
    """
    width, states = unary.shape
    out = np.empty((width, states), np.float32)
    ahead = np.zeros(states, np.float32)
    for i in range(width):
        if i > 0:
            _spread(ahead, step[i - 1])
        for r in range(states):
            ahead[r] += unary[i, r]
            out[i, r] = ahead[r]
    back = np.zeros(states, np.float32)
    for i in range(width - 1, -1, -1):
        if i < width - 1:
            _spread(back, step[i])
            for r in range(states):
                out[i, r] += back[r]
        for r in range(states):
            back[r] += unary[i, r]
    return out
