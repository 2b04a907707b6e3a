"""The CPU renderer: compiled with numba on first use, results independent of the number of threads."""

import threading
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.model.projection import DILATION, FRUSTUM_MARGIN, NEAR_DEPTH, TILE
from splatwire.scene import Cameras, Gaussians

MAX_ENTRIES = 1 << 25
"""Most (Gaussian, tile) pairs listed at a time, 12 bytes each; fuller pictures are drawn in bands of tile rows."""
_LOCK = threading.Lock()  # one of numba's threading layers does not allow two callers at once


def render_cpu(gaussians: Gaussians, cameras: Cameras, *, background: Float[Tensor, "3"]) -> Float[Tensor, "C H W 3"]:
    """Draws Gaussians with the compiled rasteriser, in float32.

    See `splatwire.render.base.Renderer` for arguments and result.
    """
    fields = (gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.colors)
    arrays = tuple(t.detach().to("cpu", torch.float32).contiguous().numpy() for t in fields)
    behind = background.detach().to("cpu", torch.float32).numpy()
    images = []
    for view in range(cameras.num_views):
        with _LOCK:
            images.append(torch.from_numpy(_Picture(arrays, cameras, view).draw(behind)))
    return torch.stack(images).to(gaussians.means.device)


class _Picture:
    """One view's projected Gaussians, and the lists of them per tile."""

    def __init__(self, arrays: tuple[np.ndarray, ...], cameras: Cameras, view: int) -> None:
        from splatwire.render import _cpu_project

        num = arrays[0].shape[0]
        self.width, self.height = cameras.width, cameras.height
        self.grid = (-(-cameras.width // TILE), -(-cameras.height // TILE))
        self.splats = np.empty((num, _cpu_project.SPLAT), np.float32)
        self.tiles = np.empty((num, 4), np.int32)
        self.num_tiles = np.empty(num, np.int64)
        self.camera = _camera_arguments(cameras, view)
        _cpu_project.project_splats(*arrays, *self.camera, self.splats, self.tiles, self.num_tiles)

    def draw(self, background: np.ndarray) -> np.ndarray:
        from splatwire.render import _cpu_kernels

        image = np.empty((self.height, self.width, 3), np.float32)
        left_over = np.empty((self.height, self.width), np.float32)
        for first_row, starts, ids, _ in self.bands():
            _cpu_kernels.draw_tiles(self.splats, starts, ids, self.grid[0], first_row, background, image, left_over)
        return image

    def bands(self) -> Any:
        """Yields (first tile row, starts, ids, entries) for bands of tile rows that together cover the image."""
        from splatwire.render import _cpu_kernels

        order = _cpu_kernels.depth_order(self.splats[:, 11], self.num_tiles)
        entry_start = np.cumsum(self.num_tiles) - self.num_tiles
        total = int(self.num_tiles.sum())
        rows = self.grid[1] if total <= MAX_ENTRIES else max(1, self.grid[1] * MAX_ENTRIES // total)
        for first in range(0, self.grid[1], rows):
            last = min(first + rows, self.grid[1])
            yield first, *_cpu_kernels.fill_tiles(order, self.tiles, self.grid[0], first, last, entry_start)


def _camera_arguments(cameras: Cameras, view: int) -> tuple[Any, ...]:
    """Pose, intrinsics, size and constants as the projection kernel takes them."""
    pose = cameras.viewmats[view].to("cpu", torch.float64).contiguous().numpy()
    K = cameras.Ks[view].to("cpu", torch.float64)
    intrinsics = (float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))
    constants = (NEAR_DEPTH, DILATION, FRUSTUM_MARGIN, float(TILE))
    return pose, intrinsics, cameras.width, cameras.height, constants
