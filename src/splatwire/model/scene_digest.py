"""A digest of the attributes of a scene: two machines that show the same one decoded the same scene."""

import hashlib
from dataclasses import fields

import torch

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
        tensor = getattr(elements, field.name).detach().cpu()
        plain = tensor.numpy().astype("u1" if tensor.dtype == torch.bool else "<f4", order="C", copy=False)
        digest.update(f"{field.name}{tuple(tensor.shape)}\0".encode())
        digest.update(plain.data)
    return digest.hexdigest()
