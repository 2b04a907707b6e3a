"""The digest of all decoded integers, which proves that both ends coded with the same parameters."""

from typing import Any

import numpy as np

from splatwire.codec.schemas.hacpp.atomic import Symbols


def update_digest(digest: Any, symbols: Symbols) -> None:
    """Adds the symbols of some anchors, one anchor after another: mask, feature, scaling, offset.

    Packets are added in plan order, so that the digest does not depend on how they were batched.

    Args:
        digest: A hashlib object.
        symbols: The symbols.
    """
    rows = np.concatenate([symbols.mask.astype("<i4"), symbols.feature, symbols.scaling, symbols.offset], axis=1)
    digest.update(np.ascontiguousarray(rows.astype("<i4")).data)
