"""Hash of a scene's attributes, to compare what different machines decoded."""

import hashlib
from dataclasses import fields

import numpy as np

from splatwire.ops.arrays import to_numpy
from splatwire.types.anchors import Anchors
from splatwire.types.splats import Splats


def scene_digest(elements: Anchors | Splats) -> str:
    """Computes the SHA-256 of the name, shape and values of all attributes of Gaussians or anchors.

    The digest depends on the order of the elements.

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
