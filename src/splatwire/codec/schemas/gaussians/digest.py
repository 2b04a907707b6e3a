"""The digest of all decoded integers, which proves that both ends coded with the same tables."""

from typing import Any

import numpy as np


def update_digest(digest: Any, rows: np.ndarray, harmonics: np.ndarray) -> None:
    """Adds the integers of one block, in the order of the plan.

    Args:
        digest: A hashlib object.
        rows: int64 (n, COLUMNS).
        harmonics: int32 (n, M).
    """
    digest.update(np.ascontiguousarray(rows.astype("<i8")).data)
    if harmonics.size:
        digest.update(np.ascontiguousarray(harmonics.astype("<i4")).data)
