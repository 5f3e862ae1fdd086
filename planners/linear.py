"""Linear programs, by HiGHS."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def minimised(cost: Array, rows: Sequence[Array], bounds: Sequence[Array], low: Array, high: Array) -> Any:
    """SciPy's result of: least cost @ x with rows @ x <= bounds and low <= x <= high; its x is None where
    there is none.

    cost, low, high: (n,); rows: blocks of (m, n), bounds: their (m,).
    """
    from scipy.optimize import linprog  # takes as long to import as all of this package

    return linprog(
        cost,
        np.concatenate(rows),
        np.concatenate(bounds),
        bounds=list(zip(low.tolist(), high.tolist(), strict=True)),
        method="highs",
    )
