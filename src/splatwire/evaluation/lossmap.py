"""Loss maps: the elements of a scene drawn as dots on a view, coloured by whether they were received or lost."""

import numpy as np
from jaxtyping import Bool, Float

from splatwire.ops.arrays import to_numpy
from splatwire.types import Cameras

LOST_COLOR = (226, 74, 51)
RECEIVED_COLOR = (44, 104, 158)
_DOT = 2
"""Side length of a dot, pixels."""


def draw_loss_map(
    positions: Float[np.ndarray, "N 3"],
    fully_received: Bool[np.ndarray, "N"],
    cameras: Cameras,
    view: int,
    picture: Float[np.ndarray, "H W 3"],
) -> np.ndarray:
    """Draws every element as a dot on a dimmed grey image: received ones blue, lost ones red.

    Args:
        positions: Decoded or expected positions of the elements, world units.
        fully_received: Mask of received elements.
        cameras: The cameras.
        view: Index of the camera.
        picture: Reference image of the view, RGB in [0, 1].

    Returns:
        RGB, uint8, (H, W, 3).
    """
    grey = (np.repeat(picture.mean(axis=2, keepdims=True), 3, axis=2) * 0.55 + 0.45) * 255
    canvas = grey.astype(np.uint8)
    pose, K = to_numpy(cameras.viewmats[view]), to_numpy(cameras.Ks[view])
    local = positions @ pose[:3, :3].T + pose[:3, 3]
    x = np.floor(local[:, 0] / local[:, 2] * K[0, 0] + K[0, 2])
    y = np.floor(local[:, 1] / local[:, 2] * K[1, 1] + K[1, 2])
    inside = (local[:, 2] > cameras.near_depth) & (x >= 0) & (y >= 0) & (x < cameras.width) & (y < cameras.height)
    for shown, color in ((inside & fully_received, RECEIVED_COLOR), (inside & ~fully_received, LOST_COLOR)):
        columns, rows = x[shown].astype(np.int64), y[shown].astype(np.int64)
        for dx, dy in np.ndindex(_DOT, _DOT):
            canvas[np.minimum(rows + dy, cameras.height - 1), np.minimum(columns + dx, cameras.width - 1)] = color
    return canvas
