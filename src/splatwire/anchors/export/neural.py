"""Network outputs for every possible Gaussian of an anchor scene, including those that a view does not draw."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int64

from splatwire.anchors.head_gradients import head_inputs, sigmoid, unit_quaternions
from splatwire.types import AnchorScene


@dataclass(frozen=True, eq=False)
class PossibleGaussians:
    """All Gaussians that an anchor scene can draw: one for each existing offset of each anchor.

    Attributes:
        anchor_index: Anchor of each Gaussian, ascending.
        offset_index: Index of each Gaussian's offset within the anchor.
        means: Centre of each Gaussian, which is the same in all views; world units, relative to the scene's origin.
    """

    anchor_index: Int64[np.ndarray, "S"]
    offset_index: Int64[np.ndarray, "S"]
    means: Float[np.ndarray, "S 3"]

    @property
    def num_gaussians(self) -> int:
        """Number of Gaussians that the scene can draw, S."""
        return int(self.anchor_index.shape[0])

    def part(self, first: int, last: int) -> "PossibleGaussians":
        """Returns the Gaussians from index `first` to `last` (exclusive)."""
        return PossibleGaussians(self.anchor_index[first:last], self.offset_index[first:last], self.means[first:last])


@dataclass(frozen=True, eq=False)
class GaussiansInView:
    """Attributes that the head networks predict for a list of Gaussians in one view.

    Attributes:
        opacities: Predicted opacities. A Gaussian with an opacity of 0 or less is not drawn in this view.
        colors: RGB in [0, 1].
        quats: Unit quaternions, (w, x, y, z).
        scales: Standard deviations, world units.
    """

    opacities: Float[np.ndarray, "S"]
    colors: Float[np.ndarray, "S 3"]
    quats: Float[np.ndarray, "S 4"]
    scales: Float[np.ndarray, "S 3"]


def possible_gaussians(scene: AnchorScene) -> PossibleGaussians:
    """Lists all Gaussians that an anchor scene can draw, without anchors hidden by loss concealment."""
    anchors = scene.anchors
    mask = anchors.mask if scene.hints is None else anchors.mask & ~scene.hints.left_out[:, None]
    anchor_index, offset_index = np.nonzero(mask)
    offsets = anchors.offsets[anchor_index, offset_index]
    means = anchors.positions[anchor_index] + offsets * anchors.scalings[anchor_index, :3]
    return PossibleGaussians(anchor_index, offset_index, means)


def gaussians_in_view(
    scene: AnchorScene, possible: PossibleGaussians, camera_center: Float[np.ndarray, "3"]
) -> GaussiansInView:
    """Evaluates the scene's head networks for a list of Gaussians and a camera position.

    Args:
        scene: The anchor scene.
        possible: The Gaussians.
        camera_center: Position of the camera, world units, relative to the scene's origin.
    """
    anchors, heads = scene.anchors, scene.heads
    index, row = np.unique(possible.anchor_index, return_inverse=True)
    offset = possible.offset_index
    inputs = head_inputs(anchors.positions[index], anchors.features[index], camera_center)
    num_offsets = anchors.mask.shape[1]
    shape = heads.covariance(inputs).reshape(-1, num_offsets, 7)[row, offset]
    scales = anchors.scalings[possible.anchor_index, 3:6] * sigmoid(shape[:, :3])
    opacities = np.tanh(heads.opacity(inputs))[row, offset]
    if scene.hints is not None:
        scales = scales * scene.hints.size_gain[possible.anchor_index, None]
        if scene.hints.opacity_gain is not None:
            opacities = np.minimum(opacities * scene.hints.opacity_gain[possible.anchor_index], 1)
    return GaussiansInView(
        opacities=opacities,
        colors=sigmoid(heads.color(inputs).reshape(-1, num_offsets, 3)[row, offset]),
        quats=unit_quaternions(shape[:, 3:7])[0],
        scales=scales,
    )
