"""A digest of the attributes of a scene: two machines that show the same one decoded the same scene."""

import hashlib
from dataclasses import fields

import numpy as np

from splatwire.ops.arrays import to_numpy
from splatwire.scene import Anchors
from splatwire.scene.splats import Splats


def scene_digest(elements: Anchors | Splats) -> str:
    """Computes the SHA-256 of all attribute tensors, in the order of their fields.

    Each tensor contributes its name, its shape and its values (float32 little-endian, masks as bytes 0 and 1). The
    order of the elements counts: a decoder's is that of the stream.

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
