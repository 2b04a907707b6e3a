"""Generates the Gaussians that anchors have in a view, and back-propagates gradients to the anchors, with numpy."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int64

from splatwire.anchors.projection import project
from splatwire.reprs import summary_repr
from splatwire.types import Anchors, Cameras, Gaussians
from splatwire.types.anchor_scene import GaussianHeads
from splatwire.types.networks import Mlp

_MIN_NORM = 1e-12


def visible_anchors(anchors: Anchors, cameras: Cameras, view: int) -> Bool[np.ndarray, "N"]:
    """Returns the mask of the anchors that camera `view` may see (HAC++ pre-filter).

    An anchor may be visible if it is beyond the near plane, and if an ellipsoid around it reaches the image. The
    semi-axes of this ellipsoid are three times the first three values of the anchor's `scalings`.
    """
    projected = project(anchors.positions, anchors.scalings[:, :3], None, cameras, view)
    return projected.touches_image(cameras.width, cameras.height)


def head_inputs(
    positions: Float[np.ndarray, "N 3"], features: Float[np.ndarray, "N F"], camera_center: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "N D"]:
    """Returns the network inputs: feature, direction from the camera, distance from the camera."""
    ray = positions - camera_center
    distance = np.maximum(np.linalg.norm(ray, axis=1, keepdims=True), 1e-9)
    return np.concatenate([features, ray / distance, distance], axis=1)


def sigmoid(values: np.ndarray) -> np.ndarray:
    """Returns the logistic function of the values, in their dtype."""
    return 0.5 * (1 + np.tanh(0.5 * values))


def unit_quaternions(raw: Float[np.ndarray, "G 4"]) -> tuple[Float[np.ndarray, "G 4"], Float[np.ndarray, "G 1"]]:
    """Returns normalised quaternions, and the lengths before the normalisation."""
    norm = np.maximum(np.linalg.norm(raw, axis=1, keepdims=True), raw.dtype.type(_MIN_NORM))
    return raw / norm, norm


@dataclass(frozen=True, eq=False)
class AnchorGradients:
    """Gradients of a loss with respect to the attributes of M anchors.

    Attributes:
        features: Gradient with respect to the features.
        scalings: Gradient with respect to the scalings.
        offsets: Gradient with respect to the offsets.
    """

    features: Float[np.ndarray, "M F"]
    scalings: Float[np.ndarray, "M 6"]
    offsets: Float[np.ndarray, "M K 3"]

    __repr__ = summary_repr


class Spawning:
    """Gaussians generated from anchors for one view, with back-propagation to the anchors (NumPy).

    Args:
        anchors: The anchors, none of which may be at the camera centre.
        heads: The networks that predict the Gaussians.
        camera_center: Camera centre, world units.

    Attributes:
        gaussians: Gaussians of existing offsets with positive opacity, ordered by anchor.
        anchor_index: Index of each Gaussian's anchor, int64 (G).
        offset_index: Index of each Gaussian's offset within the anchor, int64 (G).
    """

    gaussians: Gaussians
    anchor_index: Int64[np.ndarray, "G"]
    offset_index: Int64[np.ndarray, "G"]

    def __init__(self, anchors: Anchors, heads: GaussianHeads, camera_center: Float[np.ndarray, "3"]) -> None:
        self._anchors, num_offsets = anchors, anchors.mask.shape[1]
        inputs = head_inputs(anchors.positions, anchors.features, camera_center)
        opacity, shape, color = self._passes = [_Pass(head, inputs) for head in vars(heads).values()]
        opacities = np.tanh(opacity.outputs)
        row, offset = np.nonzero((opacities > 0) & anchors.mask)
        self.anchor_index, self.offset_index = row, offset
        raw = shape.outputs.reshape(-1, num_offsets, 7)[row, offset]
        self._share = sigmoid(raw[:, :3])
        quats, self._norm = unit_quaternions(raw[:, 3:7])
        scalings = anchors.scalings[row]
        self.gaussians = Gaussians(
            anchors.positions[row] + anchors.offsets[row, offset] * scalings[:, :3],
            quats,
            scalings[:, 3:6] * self._share,
            opacities[row, offset],
            sigmoid(color.outputs.reshape(-1, num_offsets, 3)[row, offset]),
        )

    def gradients(self, upstream: Sequence[np.ndarray]) -> AnchorGradients:
        """Back-propagates gradients to the anchors.

        Args:
            upstream: Gradients of the loss with respect to means, quats, scales, opacities and colors of the Gaussians.
        """
        means, quats, scales, opacities, colors = upstream
        anchors, drawn, row, offset = self._anchors, self.gaussians, self.anchor_index, self.offset_index
        num, num_offsets = anchors.mask.shape
        scalings = anchors.scalings[row]
        d_shape = np.zeros((num, num_offsets, 7), np.float32)
        d_shape[row, offset, :3] = scales * scalings[:, 3:6] * self._share * (1 - self._share)
        along = (quats * drawn.quats).sum(axis=1, keepdims=True)
        d_shape[row, offset, 3:] = (quats - drawn.quats * along) / self._norm
        d_opacity, d_color = np.zeros((num, num_offsets), np.float32), np.zeros((num, num_offsets, 3), np.float32)
        d_opacity[row, offset] = opacities * (1 - drawn.opacities**2)
        d_color[row, offset] = colors * drawn.colors * (1 - drawn.colors)
        each = (d_opacity, d_shape.reshape(num, 7 * num_offsets), d_color.reshape(num, 3 * num_offsets))
        inputs = [part.back(gradient) for part, gradient in zip(self._passes, each, strict=True)]
        features = (inputs[0] + inputs[1] + inputs[2])[:, : anchors.features.shape[1]]
        moved = np.concatenate([means * anchors.offsets[row, offset], scales * self._share], axis=1)
        d_offsets = np.zeros(anchors.offsets.shape, np.float32)
        d_offsets[row, offset] = means * scalings[:, :3]
        columns = [np.bincount(row, column, num) for column in moved.T]
        return AnchorGradients(features, np.stack(columns, axis=1).astype(np.float32), d_offsets)


class _Pass:
    """Forward pass of a network for a batch of inputs, with the values that back-propagation needs."""

    def __init__(self, network: Mlp, inputs: Float[np.ndarray, "N in"]) -> None:
        self._network = network
        hidden = inputs @ network.hidden.weight.T + network.hidden.bias
        self._slope = np.where(hidden > 0, np.float32(1), np.float32(network.negative_slope))
        self.outputs = (hidden * self._slope) @ network.output.weight.T + network.output.bias

    def back(self, gradient: Float[np.ndarray, "N out"]) -> Float[np.ndarray, "N in"]:
        """Back-propagates a gradient with respect to the outputs; returns the gradient with respect to the inputs."""
        return ((gradient @ self._network.output.weight) * self._slope) @ self._network.hidden.weight
