"""The CPU renderer: compiled with numba on first use, results independent of the number of threads."""

import itertools
import threading
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.model.projection import DILATION, FRUSTUM_MARGIN, NEAR_DEPTH, TILE
from splatwire.render.base import Drawing
from splatwire.scene import Cameras, Gaussians

MAX_ENTRIES = 1 << 23
"""Most (Gaussian, tile) pairs listed at a time, 10 bytes each and 36 for gradients; fuller pictures go in bands."""
_LOCK = threading.Lock()  # one of numba's threading layers does not allow two callers at once


def render_cpu(
    gaussians: Gaussians,
    cameras: Cameras,
    *,
    background: Float[Tensor, "3"],
    probe: Float[Tensor, "C G 2"] | None = None,
) -> Float[Tensor, "C H W 3"]:
    """Draws Gaussians with the compiled rasteriser, in float32; differentiable in the Gaussians and the background.

    Args:
        gaussians: What to draw.
        cameras: Where from, one or more views.
        background: RGB behind everything.
        probe: Zeros that are added to nothing; their gradient becomes that of the 2D centres, in pixels.

    Returns:
        RGB, not clamped, on the device of the Gaussians.
    """
    fields = (gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.colors)
    inputs = [t.to("cpu", torch.float32).contiguous() for t in (*fields, background)]
    views = []
    for view in range(cameras.num_views):
        shift = None if probe is None else probe[view]
        views.append(_Rasterize.apply(cameras, view, shift, *inputs))
    return torch.stack(views).to(gaussians.means.device)


def draw_cpu(gaussians: Gaussians, cameras: Cameras, *, background: Float[Tensor, "3"], watched: bool) -> Drawing:
    """Draws a view for training; see `splatwire.render.base.TrainingRenderer`."""
    probe = torch.zeros(1, gaussians.num_gaussians, 2, requires_grad=True) if watched else None
    return Drawing(render_cpu(gaussians, cameras, background=background, probe=probe)[0], probe)


class _Rasterize(torch.autograd.Function):
    """One view. Inputs after the probe: means, quats, scales, opacities, colors, background."""

    @staticmethod
    def forward(ctx: Any, cameras: Cameras, view: int, probe: Tensor | None, *inputs: Tensor) -> Tensor:
        *arrays, background = (t.detach().numpy() for t in inputs)
        with _LOCK:
            picture = _Picture(arrays, cameras, view)
            image, left_over = picture.draw(background)
        ctx.picture, ctx.left_over, ctx.has_probe = picture, left_over, probe is not None
        result = torch.from_numpy(image)
        ctx.save_for_backward(*inputs, result)
        return result

    @staticmethod
    def backward(ctx: Any, *d_images: Tensor) -> tuple[Any, ...]:
        *inputs, _, image = ctx.saved_tensors  # saved tensors refuse to be used after a change in place
        d_image = d_images[0].detach().to(torch.float32).contiguous().numpy()
        with _LOCK:
            gradients = ctx.picture.gradients([t.detach().numpy() for t in inputs], image.detach().numpy(), d_image)
        d_background = np.einsum("hw,hwc->c", ctx.left_over, d_image)
        *d_inputs, d_probe = (torch.from_numpy(g) for g in gradients)
        return None, None, d_probe if ctx.has_probe else None, *d_inputs, torch.from_numpy(d_background)


class _Band(NamedTuple):
    """The lists of some rows of tiles."""

    first_row: int
    starts: np.ndarray
    ids: np.ndarray
    spans: np.ndarray
    places: np.ndarray
    place_starts: np.ndarray


class _Picture:
    """One view's projected Gaussians and, where one band is enough, the lists of them per tile."""

    def __init__(self, arrays: list[np.ndarray], cameras: Cameras, view: int) -> None:
        from splatwire.render import _cpu_lists, _cpu_project

        num = arrays[0].shape[0]
        self.size = (cameras.height, cameras.width)
        self.grid_x, self.grid_y = -(-cameras.width // TILE), -(-cameras.height // TILE)
        self.splats = np.empty((num, _cpu_project.SPLAT), np.float32)
        self.tiles = np.empty((num, 4), np.int32)
        self.camera = _camera_arguments(cameras, view)
        _cpu_project.project_splats(*arrays, *self.camera, self.splats, self.tiles)
        self.order = _cpu_lists.depth_order(self.splats[:, 9], self.tiles)
        cuts = self._band_rows()
        self.cuts = list(itertools.pairwise(cuts))
        self.only_band = self._fill(*self.cuts[0]) if len(self.cuts) == 1 else None

    def draw(self, background: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Draws the image and what light of the background each pixel lets through."""
        from splatwire.render import _cpu_kernels

        image, left_over = np.empty((*self.size, 3), np.float32), np.empty(self.size, np.float32)
        for band in self._bands():
            lists = (band.starts, band.ids, band.spans, self.grid_x, band.first_row)
            _cpu_kernels.draw_tiles(self.splats, *lists, background, image, left_over)
        return image, left_over

    def gradients(self, arrays: list[np.ndarray], image: np.ndarray, d_image: np.ndarray) -> list[np.ndarray]:
        """Returns the gradients of means, quats, scales, opacities, colors, and of the 2D means."""
        from splatwire.render import _cpu_gradients, _cpu_project

        num, width, spare = self.splats.shape[0], _cpu_gradients.SUMS, _cpu_gradients.SPARE
        flat = np.zeros(num * width + spare, np.float32)
        for band in self._bands():
            rows = np.zeros(band.ids.shape[0] * width + spare, np.float32)
            lists = (band.starts, band.ids, band.spans, self.grid_x, band.first_row)
            _cpu_gradients.draw_tiles_back(self.splats, *lists, image, d_image, rows)
            _cpu_gradients.add_rows(rows, self.order, band.places, band.place_starts, flat)
        results = [np.zeros_like(a) for a in arrays] + [np.zeros((num, 2), np.float32)]
        sums = flat[: num * width].reshape(num, width)
        _cpu_project.project_back(*arrays[:4], *self.camera, self.splats, self.tiles, sums, *results)
        return results

    def _bands(self) -> Iterator[_Band]:
        """Bands of tile rows that together cover the image."""
        return iter([self.only_band]) if self.only_band is not None else (self._fill(*cut) for cut in self.cuts)

    def _band_rows(self) -> list[int]:
        """Tile rows at which a new band starts, and the end: each band within `MAX_ENTRIES` unless it is one row."""
        columns = (self.tiles[:, 2] - self.tiles[:, 0]).astype(np.float64)
        change = np.bincount(self.tiles[:, 1], columns, self.grid_y + 1)
        change -= np.bincount(self.tiles[:, 3], columns, self.grid_y + 1)
        cuts, held = [0], 0.0
        for row, entries in enumerate(np.cumsum(change)[:-1]):
            if held + entries > MAX_ENTRIES and row > cuts[-1]:
                cuts.append(row)
                held = 0.0
            held += entries
        return [*cuts, self.grid_y]

    def _fill(self, first: int, last: int) -> _Band:
        from splatwire.render import _cpu_lists

        strips = _cpu_lists.reach_columns(self.splats, self.order, self.tiles, first, last)
        return _Band(first, *_cpu_lists.fill_tiles(self.order, self.tiles, *strips, self.grid_x, first, last))


def _camera_arguments(cameras: Cameras, view: int) -> tuple[Any, ...]:
    """Pose, intrinsics, size and constants as the projection kernels take them."""
    pose = cameras.viewmats[view].to("cpu", torch.float64).contiguous().numpy()
    K = cameras.Ks[view].to("cpu", torch.float64)
    intrinsics = (float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))
    constants = (NEAR_DEPTH, DILATION, FRUSTUM_MARGIN, float(TILE))
    return pose, intrinsics, cameras.width, cameras.height, constants
