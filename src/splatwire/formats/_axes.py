"""Axes of the formats: ours are those of a 3DGS PLY.

Formats are named by where x, y and z point for a camera that looks at the scene: right or left, up or down, forward or
back. A 3DGS PLY is RDF, as are compressed PLY, SOG, `.splat` and `.ksplat`; SPZ is RUB, glTF is LUF. Between two of
these are two flipped axes, that is half a turn, so Gaussians stay Gaussians and no reflection is needed.
"""

import numpy as np
import torch

from splatwire.ops.spherical_harmonics import sh_basis
from splatwire.scene.splats import Splats

SPZ_FLIPS = (1.0, -1.0, -1.0)
"""From RDF to RUB and back."""
GLTF_FLIPS = (-1.0, -1.0, 1.0)
"""From RDF to LUF and back."""


def harmonic_signs(flips: tuple[float, float, float], degree: int) -> np.ndarray:
    """What flipping two axes does to the coefficients of a degree: 1 or -1 for each, float32."""
    somewhere = torch.tensor([0.36, 0.48, 0.8])  # no basis function is 0 there
    signs = (sh_basis(somewhere * torch.tensor(flips), degree) / sh_basis(somewhere, degree)).round()
    return np.asarray(signs.numpy(), np.float32)


def flip_axes(splats: Splats, flips: tuple[float, float, float]) -> Splats:
    """Flips two of three axes of the world; its own inverse.

    Args:
        splats: The Gaussians.
        flips: 1 or -1 for x, y and z, with two of them -1.
    """
    signs = torch.tensor(flips)
    harmonics = torch.from_numpy(harmonic_signs(flips, splats.degree))
    return Splats(
        means=splats.means * signs,
        quats=splats.quats * torch.cat([torch.ones(1), signs]),
        scales=splats.scales,
        opacities=splats.opacities,
        sh=splats.sh * harmonics[:, None],
    )
