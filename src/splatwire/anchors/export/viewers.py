"""Converts Gaussians to the arguments of the Python viewers viser and Rerun.

server.scene.add_gaussian_splats("/scene", **viser_arguments(splatwire.open_scene("scene.swz")))
rerun.log("scene", rerun.GaussianSplats3D(**rerun_arguments(splatwire.open_scene("scene.swz"))))
"""

from typing import Any

import numpy as np

from splatwire.anchors.appearance import explicit_gaussians
from splatwire.errors import InvalidValueError
from splatwire.ops.quaternions import rotation_matrices
from splatwire.ops.spherical_harmonics import DC, MAX_DEGREE, num_functions
from splatwire.types.scene import Scene
from splatwire.types.splats import Splats


def viser_arguments(scene: Scene) -> dict[str, Any]:
    """Returns arguments for `add_gaussian_splats` of viser 1.1, which draws view-independent colours.

    Args:
        scene: Explicit Gaussians, G of them.

    Returns:
        `centers` (G, 3), `covariances` (G, 3, 3), `rgbs` (G, 3) and `opacities` (G, 1) in [0, 1], all float32.

    Raises:
        InvalidValueError: If the scene has no explicit Gaussians, because anchors generate them for each view.
    """
    splats = _explicit(scene)
    axes = rotation_matrices(splats.quats) * splats.scales[:, None, :]
    return {
        "centers": splats.means,
        "covariances": axes @ axes.transpose(0, 2, 1),
        "rgbs": _colours(splats),
        "opacities": splats.opacities[:, None],
    }


def rerun_arguments(scene: Scene) -> dict[str, Any]:
    """Returns arguments for `GaussianSplats3D` of Rerun 0.41.

    Args:
        scene: Explicit Gaussians, G of them.

    Returns:
        `centers` and `scales` (G, 3), `quaternions` (G, 4; x, y, z, w), `colors` (G, 4; RGBA in bytes); for degrees
        above 0 also `sh_coefficients` (G, 15, 3) and `spherical_harmonics_degree`.

    Raises:
        InvalidValueError: If the scene has no explicit Gaussians, because anchors generate them for each view.
    """
    splats = _explicit(scene)
    seen = np.concatenate([_colours(splats), splats.opacities[:, None]], axis=1)
    arguments = {
        "centers": splats.means,
        "scales": splats.scales,
        "quaternions": np.roll(splats.quats, -1, axis=1),
        "colors": np.rint(seen * 255).astype(np.uint8),
    }
    if splats.degree > 0:
        harmonics = np.zeros((splats.num_gaussians, num_functions(MAX_DEGREE) - 1, 3), np.float32)
        harmonics[:, : splats.sh.shape[1] - 1] = splats.sh[:, 1:]
        arguments |= {"sh_coefficients": harmonics, "spherical_harmonics_degree": splats.degree}
    return arguments


def _explicit(scene: Scene) -> Splats:
    splats = explicit_gaussians(scene)
    if splats is None:
        raise InvalidValueError(
            "a viewer needs explicit Gaussians, but those of anchors depend on the view: "
            "`splatwire export ply` fits explicit ones"
        )
    return splats


def _colours(splats: Splats) -> np.ndarray:
    return (0.5 + DC * splats.sh[:, 0]).clip(0, 1)
