"""Search trees of scipy, which is imported for the first tree only: its import is a third of the start of a command."""

from typing import Any

import numpy as np
from jaxtyping import Float


def build_kd_tree(points: Float[np.ndarray, "N dims"], **options: Any) -> Any:
    """Returns scipy's `cKDTree` of points.

    Args:
        points: The points.
        **options: Options of `cKDTree`.
    """
    from scipy.spatial import cKDTree

    return cKDTree(points, **options)
