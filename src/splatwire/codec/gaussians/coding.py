"""Serialises the quantisation parameters of a decoded scene, with which the scene can be encoded again without loss."""

import numpy as np

from splatwire.codec.gaussians.layout import MAX_CLASSES
from splatwire.codec.gaussians.side_info import read_header, write_header
from splatwire.errors import BitstreamError
from splatwire.types import SplatCoding


def coding_to_bytes(coding: SplatCoding) -> bytes:
    """Serialises the quantisation parameters of a scene, without the precision classes of Gaussians."""
    return write_header(coding)


def coding_from_bytes(data: bytes, precision_classes: np.ndarray, degree: int) -> SplatCoding:
    """Reads quantisation parameters serialised by `coding_to_bytes`.

    Args:
        data: Bytes from `coding_to_bytes`.
        precision_classes: Precision class of each Gaussian, which selects its quantisation steps, uint8 (N).
        degree: Degree of the scene's spherical harmonics.

    Raises:
        UnsupportedVersionError: If a newer release wrote the bytes.
        BitstreamError: If the bytes are damaged or belong to a scene of another degree, or a class is out of range.
    """
    stored_degree, size_log, lattice_bits, base_exponents, max_position_shift, transform = read_header(data)
    max_class = precision_classes.max(initial=0)
    if stored_degree != degree or max_position_shift < 0 or max_class >= MAX_CLASSES:
        raise BitstreamError(f"steps of Gaussians of degree {stored_degree} and classes up to {max_class}")
    steps = size_log, lattice_bits, max_position_shift, tuple(base_exponents.tolist())
    return SplatCoding(*steps, transform, precision_classes)
