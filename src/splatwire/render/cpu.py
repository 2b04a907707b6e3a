"""The CPU renderer, compiled with numba."""

import functools
import itertools
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from splatwire.anchors.projection import DILATION, FRUSTUM_MARGIN, TILE
from splatwire.ops.arrays import to_numpy
from splatwire.ops.threads import allowed_threads, parallel_map
from splatwire.render import _cpu_gradients, _cpu_kernels, _cpu_lists, _cpu_project
from splatwire.render._cpu_project import PROJECTED_STRIDE
from splatwire.types import Cameras, Gaussians

MAX_ENTRIES = 1 << 20
"""Maximum number of (Gaussian, tile) pairs per band of tile rows, unless a single row has more. A pair takes 14 bytes,
and 36 for gradients."""
MAX_KEPT_ENTRIES = 1 << 23
"""Maximum number of (Gaussian, tile) pairs whose lists are kept for the gradient; larger lists are computed again band
by band."""
_BANDS = 8
_CHUNK_GAUSSIANS = 8192
"""Maximum number of Gaussians that a thread projects at a time."""
_GLIBC_MAX_THRESHOLD = (32 << 20) - 8192  # bytes; larger blocks do not change glibc's threshold


def render_cpu(
    gaussians: Gaussians, cameras: Cameras, *, background: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "C H W 3"]:
    """Renders Gaussians with the compiled rasteriser, in float32.

    Args:
        gaussians: The Gaussians.
        cameras: Cameras of one or more views.
        background: RGB of the background.

    Returns:
        RGB, not clamped, float32.
    """
    keep_freed_memory()
    arrays, background = float_arrays(gaussians), np.asarray(background, np.float32)
    views = [
        ViewRasterizer(arrays, cameras, view, for_gradients=False).draw(background)[0]
        for view in range(cameras.num_views)
    ]
    return np.stack(views) if len(views) > 1 else views[0][None]  # avoids a copy of a large image


def float_arrays(gaussians: Gaussians) -> list[np.ndarray]:
    """Returns means, quats, scales, opacities and colors as contiguous float32."""
    return [np.ascontiguousarray(to_numpy(values), np.float32) for values in vars(gaussians).values()]


def each_gradient_cpu(
    gaussians: Gaussians,
    cameras: Cameras,
    image_gradients: Callable[[tuple[int, ...]], Iterator[np.ndarray]],
    on_gradients: Callable[..., None],
    background: np.ndarray | None = None,
) -> None:
    """Renders a view once, and back-propagates one or more image gradients to the Gaussians.

    Args:
        gaussians: The Gaussians, float32 on the CPU.
        cameras: Camera of one view.
        image_gradients: Function that gets the shape of the image, and yields gradients of losses with respect to the
            image, float32.
        on_gradients: Function that receives a range of Gaussians (slice), and the gradients of their means, quats,
            scales, opacities and colors. It is called from several threads.
        background: RGB of the background, float32 (3); None for black.
    """
    # To limit memory, gradients are computed for one slice after another. `image_gradients` is called once; each of its
    # gradients is back-propagated before the next is requested.
    keep_freed_memory()
    arrays = float_arrays(gaussians)
    rasterizer = ViewRasterizer(arrays, cameras, 0, for_gradients=True)
    image, _ = rasterizer.draw(np.zeros(3, np.float32) if background is None else background)
    for gradient in image_gradients(image.shape):
        rasterizer.each_gradient(arrays, image, gradient, on_gradients)


@functools.cache
def keep_freed_memory() -> None:
    """Makes glibc keep up to 64 MiB of freed memory for reuse by the next image."""
    # Requesting it from the system for each image would cost a tenth of the rendering time.
    np.empty(_GLIBC_MAX_THRESHOLD, np.uint8)


class _Band(NamedTuple):
    """Consecutive rows of image tiles, with a list of Gaussians for each tile.

    Attributes:
        first_row: First row of tiles.
        order: Indices of the Gaussians in the band, nearest first.
        starts: Start of each tile's list in `ids`, and the end of the last list.
        ids: Lists of all tiles, one after another: indices of Gaussians, nearest first.
        spans: Pixel rows that each entry of `ids` covers in its tile: first row and end (exclusive).
        entries: Indices of the entries of `ids`, sorted by Gaussian in the order of `order`.
        entry_starts: Start of each Gaussian's entries in `entries`, and the end of the last.
    """

    first_row: int
    order: np.ndarray
    starts: np.ndarray
    ids: np.ndarray
    spans: np.ndarray
    entries: np.ndarray
    entry_starts: np.ndarray


class ViewRasterizer:
    """Renders one view on the CPU, and computes the gradients of the image.

    Args:
        arrays: Means, quats, scales, opacities, colors.
        cameras: The cameras.
        view: Index of the camera.
        for_gradients: True to keep data for computing gradients after drawing. The gradients then do not depend on the
            number of threads.
    """

    # Threads divide the work by ranges of Gaussians and by bands (consecutive rows of tiles). The image does not
    # depend on this division. With `for_gradients`, the number of bands is the same for any number of threads, because
    # gradients of different divisions differ by rounding errors.

    def __init__(self, arrays: list[np.ndarray], cameras: Cameras, view: int, *, for_gradients: bool) -> None:
        num = arrays[0].shape[0]
        self.size = (cameras.height, cameras.width)
        self.grid_x, self.grid_y = -(-cameras.width // TILE), -(-cameras.height // TILE)
        self.projected = _allocate_projected(num)
        self.tiles = np.empty((num, 4), np.int32)
        self.camera = _camera_arguments(cameras, view)

        def project(piece: slice) -> None:
            chunk = [a[piece] for a in arrays]
            _cpu_project.project_splats(*chunk, *self.camera, self.projected[piece], self.tiles[piece])

        parallel_map(project, _pieces(num))
        pairs_per_row = _cpu_lists.count_row_pairs(self.tiles, self.grid_y)
        starts = _band_starts(pairs_per_row, _BANDS if for_gradients else max(_BANDS, 2 * allowed_threads()))
        self.band_ranges = list(itertools.pairwise(starts))
        self.stored_bands: list[_Band] | None = None
        self.stores_bands = for_gradients and pairs_per_row.sum() <= MAX_KEPT_ENTRIES

    def draw(self, background: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Draws the view: returns the image, and the remaining transmittance of each pixel."""
        image, transmittance = np.empty((*self.size, 3), np.float32), np.empty(self.size, np.float32)

        def draw(number: int) -> _Band | None:
            band = self._build_band(number)
            lists = (band.starts, band.ids, band.spans, self.grid_x, band.first_row)
            _cpu_kernels.draw_tiles(self.projected, *lists, background, image, transmittance)
            return band if self.stores_bands else None

        self.stored_bands = [band for band in parallel_map(draw, range(len(self.band_ranges))) if band is not None]
        return image, transmittance

    def gradients(self, arrays: list[np.ndarray], image: np.ndarray, d_image: np.ndarray) -> list[np.ndarray]:
        """Returns the gradients of the loss with respect to means, quats, scales, opacities, colors, and the 2D means.

        Args:
            arrays: Means, quats, scales, opacities, colors.
            image: The rendered image.
            d_image: Gradient of the loss with respect to the image.
        """
        sums, results = self._gradient_sums(image, d_image), _zeros(arrays)
        parallel_map(
            lambda piece: self._project_back(arrays, sums, piece, [r[piece] for r in results]), _pieces(len(sums))
        )
        return results

    def each_gradient(
        self, arrays: list[np.ndarray], image: np.ndarray, d_image: np.ndarray, on_gradients: Callable[..., None]
    ) -> None:
        """Computes the gradients of means, quats, scales, opacities and colors for one slice after another.

        Args:
            arrays: Means, quats, scales, opacities, colors.
            image: The rendered image.
            d_image: Gradient of the loss with respect to the image.
            on_gradients: Function called with each slice of the Gaussians and its five gradients, from several threads.
        """
        sums = self._gradient_sums(image, d_image)

        def project_back_slice(piece: slice) -> None:
            out = _zeros([a[piece] for a in arrays])
            self._project_back(arrays, sums, piece, out)
            on_gradients(piece, *out[:5])

        parallel_map(project_back_slice, _pieces(len(sums)))

    def _gradient_sums(self, image: np.ndarray, d_image: np.ndarray) -> np.ndarray:
        """Computes the gradients with respect to the projected Gaussians, summed over all pixels, float32 (G, SUMS).

        Args:
            image: The rendered picture.
            d_image: Gradient of the loss with respect to the picture.
        """
        num, width, spare = self.projected.shape[0], _cpu_gradients.SUMS, _cpu_gradients.SPARE
        flat = np.zeros(num * width + spare, np.float32)
        for band in self._bands():
            self._add_gradients(band, image, d_image, flat)
        return flat[: num * width].reshape(num, width)

    def _project_back(
        self, arrays: list[np.ndarray], sums: np.ndarray, piece: slice, results: list[np.ndarray]
    ) -> None:
        chunk = [a[piece] for a in arrays[:4]]
        _cpu_project.project_back(*chunk, *self.camera, self.projected[piece], self.tiles[piece], sums[piece], *results)

    def _add_gradients(self, band: _Band, image: np.ndarray, d_image: np.ndarray, sums: np.ndarray) -> None:
        """Adds the gradients of the pixels in one band of tile rows to the gradient sums of the projected Gaussians.

        Args:
            band: The band.
            image: The rendered image.
            d_image: Gradient of the loss with respect to the image.
            sums: Gradient sums of all projected Gaussians; changed in place.
        """
        rows = np.zeros(band.ids.shape[0] * _cpu_gradients.SUMS + _cpu_gradients.SPARE, np.float32)
        lists = (band.starts, band.ids, band.spans, self.grid_x, band.first_row)

        parallel_map(
            lambda row: _cpu_gradients.draw_tiles_back(
                self.projected, *lists, image, d_image, rows, row * self.grid_x, (row + 1) * self.grid_x
            ),
            range((band.starts.shape[0] - 1) // self.grid_x),
        )
        parallel_map(
            lambda piece: _cpu_gradients.add_rows(
                rows, band.order[piece], band.entries, band.entry_starts[piece.start : piece.stop + 1], sums
            ),
            _pieces(band.order.shape[0]),
        )

    def _bands(self) -> Iterator[_Band]:
        """Yields groups of tile rows that together cover the image."""
        return (
            iter(self.stored_bands)
            if self.stored_bands
            else (self._build_band(number) for number in range(len(self.band_ranges)))
        )

    def _build_band(self, number: int) -> _Band:
        """Lists the Gaussians of each tile of a band."""
        first_row, end_row = self.band_ranges[number]
        order, columns = _cpu_lists.depth_order(self.projected, self.tiles, first_row, end_row)
        return _Band(
            first_row, order, *_cpu_lists.fill_tiles(self.projected, order, columns, self.grid_x, first_row, end_row)
        )


def _allocate_projected(num: int) -> np.ndarray:
    """Allocates an uninitialised array for projected Gaussians, aligned to cache lines.

    Args:
        num: Number of Gaussians.

    Returns:
        float32 (num, PROJECTED_STRIDE).
    """
    # Aligned to cache lines.
    floats = np.empty((num + 1) * PROJECTED_STRIDE, np.float32)
    first = -floats.ctypes.data % 64 // 4
    return floats[first : first + num * PROJECTED_STRIDE].reshape(num, PROJECTED_STRIDE)


def _zeros(arrays: list[np.ndarray]) -> list[np.ndarray]:
    """Allocates zeros for the gradients of means, quats, scales, opacities, colors and 2D means."""
    return [*(np.zeros_like(a) for a in arrays), np.zeros((len(arrays[0]), 2), np.float32)]


def _pieces(num: int) -> list[slice]:
    return [slice(first, min(first + _CHUNK_GAUSSIANS, num)) for first in range(0, num, _CHUNK_GAUSSIANS)]


def _band_starts(pairs_per_row: np.ndarray, num_bands: int) -> list[int]:
    """Divides the rows of tiles into bands with a limited number of (Gaussian, tile) pairs.

    Args:
        pairs_per_row: Number of (Gaussian, tile) pairs in each row of tiles.
        num_bands: Wanted number of bands; large bands are divided further.

    Returns:
        The first row of each band, and the end of the last band (exclusive).
    """
    # Each band has at most `MAX_ENTRIES` (Gaussian, tile) pairs, or is a single row of tiles.
    limit = min(MAX_ENTRIES, pairs_per_row.sum() / num_bands)
    starts, num_pairs = [0], 0.0
    for row, row_pairs in enumerate(pairs_per_row):
        if num_pairs + row_pairs > limit and row > starts[-1]:
            starts.append(row)
            num_pairs = 0.0
        num_pairs += row_pairs
    return [*starts, len(pairs_per_row)]


def _camera_arguments(cameras: Cameras, view: int) -> tuple[Any, ...]:
    """Returns the camera arguments of the projection kernels: pose, intrinsics, image size and constants."""
    pose = np.ascontiguousarray(to_numpy(cameras.viewmats[view]), np.float64)
    K = to_numpy(cameras.Ks[view]).astype(np.float64)
    intrinsics = (float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))
    constants = (float(cameras.near_depth), DILATION, FRUSTUM_MARGIN, float(TILE))
    return pose, intrinsics, cameras.width, cameras.height, constants
