"""What Gaussians were rounded to, as bytes: files that keep it encode to the same integers again."""

import numpy as np

from splatwire.codec.schemas.gaussians.layout import MAX_CLASSES
from splatwire.codec.schemas.gaussians.side_info import read_header, write_header
from splatwire.errors import BitstreamError
from splatwire.model import SplatCoding


def coding_to_bytes(coding: SplatCoding) -> bytes:
    """Writes what a scene's Gaussians share; the class of each is not in it."""
    return write_header(coding)


def coding_from_bytes(data: bytes, classes: np.ndarray, degree: int) -> SplatCoding:
    """Reads it again.

    Args:
        data: As `coding_to_bytes` writes it.
        classes: Class of precision of each Gaussian, uint8 (N).
        degree: Of the scene's harmonics.

    Raises:
        UnsupportedVersionError: If a newer release wrote it.
        BitstreamError: If it is damaged, or of a scene of another degree.
    """
    own, size_log, unit, bases, coarsest, transform = read_header(data)
    if own != degree or coarsest < 0 or classes.max(initial=0) >= MAX_CLASSES:
        raise BitstreamError(f"steps of Gaussians of degree {own} and classes up to {classes.max(initial=0)}")
    steps = size_log, unit, coarsest, tuple(bases.tolist())
    return SplatCoding(*steps, transform, classes)
