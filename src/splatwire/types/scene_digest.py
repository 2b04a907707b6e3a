"""Digest of a scene's attributes: equal digests on two machines mean that both decoded the same scene."""

import hashlib
from dataclasses import fields

import numpy as np

from splatwire.ops.arrays import to_numpy
from splatwire.types.anchors import Anchors
from splatwire.types.splats import Splats


def scene_digest(elements: Anchors | Splats) -> str:
    """Computes the SHA-256 of all attribute arrays of Gaussians or anchors, in the order of their fields.

    Each tensor contributes its name, shape and values (float32 little-endian, masks as bytes 0 and 1). The digest
    depends on the element order; a decoder keeps the order of the stream.

    Args:
        elements: The elements of a scene.

    Returns:
        64 hexadecimal digits.
    """
    digest = hashlib.sha256(b"splatwire/scene-digest/1\0")
    for field in fields(elements):
        values = to_numpy(getattr(elements, field.name))
        plain = values.astype("u1" if values.dtype == np.bool_ else "<f4", order="C", copy=False)
        digest.update(f"{field.name}{values.shape}\0".encode())
        digest.update(plain.data)
    return digest.hexdigest()
