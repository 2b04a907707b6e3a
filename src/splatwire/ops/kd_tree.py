"""Search trees of scipy, imported on first use."""

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
