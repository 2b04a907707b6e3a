"""Typical size of the anchors of each importance tier, as a named section of the side information."""

from collections.abc import Mapping

import numpy as np

from splatwire.bitstream import Manifest
from splatwire.errors import BitstreamError
from splatwire.types import Anchors

SECTION = "tier_sizes"
"""Name of the section."""
_STEPS = 8
"""Quantisation steps per octave; the error of a size is at most 5 %."""
_MAX_CODE = 255


def encode_tier_sizes(anchors: Anchors, tiers: np.ndarray, num_tiers: int) -> bytes:
    """Encodes the typical size of the anchors in each importance tier.

    Concealers use these sizes as weights when they compute the lost share of a scene.

    Args:
        anchors: The N anchors in coding order.
        tiers: Importance tier of each anchor, (N); no tier is empty.
        num_tiers: Number of tiers.

    Returns:
        One byte per tier.
    """
    sizes = relative_sizes(anchors.scalings[:, 3:6], anchors.mask.sum(axis=1), tiers, num_tiers)
    return np.rint(-_STEPS * np.log2(sizes)).clip(max=_MAX_CODE).astype(np.uint8).tobytes()


def relative_sizes(sizes: np.ndarray, gaussians: np.ndarray, tiers: np.ndarray, num_tiers: int) -> np.ndarray:
    """Returns the typical size of the anchors in each importance tier, relative to the tier with the largest anchors.

    Args:
        sizes: Base sizes of the anchors' Gaussians along three axes, (N, 3).
        gaussians: Number of Gaussians of each anchor, (N).
        tiers: Importance tier of each anchor, (N); no tier is empty.
        num_tiers: Number of tiers.

    Returns:
        Relative sizes, float64 (tiers), above 0 and at most 1.
    """
    # The size of a tier is the square root of the mean footprint of its anchors. An anchor's footprint is the product
    # of its two largest sizes times its number of Gaussians.
    axes = np.sort(np.nan_to_num(sizes.astype(np.float32)).clip(min=0).astype(np.float64), axis=1)
    footprints = axes[:, 1] * axes[:, 2] * gaussians
    means = np.bincount(tiers, footprints, num_tiers) / np.bincount(tiers, minlength=num_tiers)
    means = np.clip(means, np.finfo(np.float64).tiny, np.finfo(np.float64).max)
    return np.exp2((np.log2(means) - np.log2(means.max())) / 2)


def read_tier_sizes(sections: Mapping[str, bytes], manifest: Manifest) -> np.ndarray | None:
    """Reads the typical size of the anchors in each importance tier, relative to the tier with the largest anchors.

    Args:
        sections: Named sections of the stream's side information.
        manifest: The stream's manifest.

    Returns:
        Relative sizes, float32 (tiers), above 0 and at most 1; None if the section is absent.

    Raises:
        BitstreamError: If the section is damaged, or the stream has no tiers.
    """
    if SECTION not in sections:
        return None
    data, subject = sections[SECTION], f"section '{SECTION}'"
    if len(data) != len(manifest.tiers):
        raise BitstreamError(f"{subject} has {len(data)} bytes for {len(manifest.tiers)} tiers")
    steps = np.frombuffer(data, dtype=np.uint8)
    if not len(steps) or steps.min() > 0:
        raise BitstreamError(f"{subject}: no tier is the largest")
    return np.exp2(steps / -_STEPS).astype(np.float32)
