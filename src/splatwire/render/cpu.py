"""The CPU renderer: compiled with numba on first use, results independent of the number of threads."""

import functools
import itertools
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from splatwire.model.projection import DILATION, FRUSTUM_MARGIN, NEAR_DEPTH, TILE
from splatwire.ops.arrays import to_numpy
from splatwire.ops.threads import allowed_threads, share
from splatwire.scene import Cameras, Gaussians

MAX_ENTRIES = 1 << 20
"""Most (Gaussian, tile) pairs of a band, 14 bytes each and 36 for gradients, unless one row of tiles has more."""
KEPT_ENTRIES = 1 << 23
"""Most pairs whose lists are kept for the gradient; those of fuller pictures are made again, band by band."""
_BANDS = 8
_PIECE = 8192  # Gaussians
_GLIBC_LARGEST = (32 << 20) - 8192  # bytes: no larger block changes what it keeps


def render_cpu(
    gaussians: Gaussians, cameras: Cameras, *, background: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "C H W 3"]:
    """Draws Gaussians with the compiled rasteriser, in float32; `splatwire.render.differentiable` follows gradients.

    Args:
        gaussians: What to draw.
        cameras: Where from, one or more views.
        background: RGB behind everything.

    Returns:
        RGB, not clamped, float32.
    """
    keep_freed_memory()
    arrays, behind = float_arrays(gaussians), np.asarray(background, np.float32)
    views = [Picture(arrays, cameras, view, kept=False).draw(behind)[0] for view in range(cameras.num_views)]
    return np.stack(views) if len(views) > 1 else views[0][None]  # large pictures take long to copy


def float_arrays(gaussians: Gaussians) -> list[np.ndarray]:
    """Means, quats, scales, opacities and colors as contiguous arrays of float32."""
    return [np.ascontiguousarray(to_numpy(values), np.float32) for values in vars(gaussians).values()]


def each_gradient_cpu(
    gaussians: Gaussians,
    cameras: Cameras,
    d_image: Callable[[tuple[int, ...]], Iterator[np.ndarray]],
    use: Callable[..., None],
    background: np.ndarray | None = None,
) -> None:
    """Draws a view and hands on gradients as they are found.

    Args:
        gaussians: What to draw, float32 on the CPU.
        cameras: Where from; one view.
        d_image: Gives gradients by the picture, of the shape that it is called with, float32, one after another.
        use: Called with a slice of the Gaussians and the gradients of their means, quats, scales, opacities and
            colors, by several threads.
        background: RGB behind everything, float32 (3); None for black.
    """
    keep_freed_memory()
    arrays = float_arrays(gaussians)
    picture = Picture(arrays, cameras, 0, kept=True)
    image, _ = picture.draw(np.zeros(3, np.float32) if background is None else background)
    for gradient in d_image(image.shape):
        picture.each_gradient(arrays, image, gradient, use)


@functools.cache
def keep_freed_memory() -> None:
    """Has glibc keep twice the size of the largest block that was freed, 64 MiB at most, instead of giving it back.

    Every picture needs as much room as the last one; as fresh pages it costs a tenth of the picture's time.
    """
    np.empty(_GLIBC_LARGEST, np.uint8)


class _Band(NamedTuple):
    """The lists of some rows of tiles."""

    first_row: int
    order: np.ndarray
    starts: np.ndarray
    ids: np.ndarray
    spans: np.ndarray
    places: np.ndarray
    place_starts: np.ndarray


class Picture:
    """One view's projected Gaussians and, where they are kept, the lists of them per tile.

    Threads share the Gaussians by pieces and the picture by bands of tile rows. No pixel depends on how it is cut.

    Args:
        arrays: Means, quats, scales, opacities, colors.
        cameras: The cameras.
        view: Which of them.
        kept: Whether gradients may be asked for: their sums depend on the bands, so these must not depend on threads.
    """

    def __init__(self, arrays: list[np.ndarray], cameras: Cameras, view: int, *, kept: bool) -> None:
        from splatwire.render import _cpu_lists, _cpu_project

        num = arrays[0].shape[0]
        self.size = (cameras.height, cameras.width)
        self.grid_x, self.grid_y = -(-cameras.width // TILE), -(-cameras.height // TILE)
        self.splats = _cache_lines(num)
        self.tiles = np.empty((num, 4), np.int32)
        self.camera = _camera_arguments(cameras, view)

        def project(piece: slice) -> None:
            mine = [a[piece] for a in arrays]
            _cpu_project.project_splats(*mine, *self.camera, self.splats[piece], self.tiles[piece])

        share(project, _pieces(num))
        entries = _cpu_lists.row_entries(self.tiles, self.grid_y)
        cuts = _cuts(entries, _BANDS if kept else max(_BANDS, 2 * allowed_threads()))
        self.cuts = list(itertools.pairwise(cuts))
        self.kept: list[_Band] | None = None
        self.may_keep = kept and entries.sum() <= KEPT_ENTRIES

    def draw(self, background: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Draws the image and what light of the background each pixel lets through."""
        from splatwire.render import _cpu_kernels

        image, left_over = np.empty((*self.size, 3), np.float32), np.empty(self.size, np.float32)

        def draw(number: int) -> _Band | None:
            band = self._fill(number)
            lists = (band.starts, band.ids, band.spans, self.grid_x, band.first_row)
            _cpu_kernels.draw_tiles(self.splats, *lists, background, image, left_over)
            return band if self.may_keep else None

        self.kept = [band for band in share(draw, range(len(self.cuts))) if band is not None]
        return image, left_over

    def gradients(self, arrays: list[np.ndarray], image: np.ndarray, d_image: np.ndarray) -> list[np.ndarray]:
        """Returns the gradients of means, quats, scales, opacities, colors, and of the 2D means."""
        sums, results = self._sums(image, d_image), _zeros(arrays)
        share(lambda piece: self._project_back(arrays, sums, piece, [r[piece] for r in results]), _pieces(len(sums)))
        return results

    def each_gradient(
        self, arrays: list[np.ndarray], image: np.ndarray, d_image: np.ndarray, use: Callable[..., None]
    ) -> None:
        """Hands the gradients of some Gaussians at a time to `use`, with where these are; see `gradients`."""
        sums = self._sums(image, d_image)

        def some(piece: slice) -> None:
            out = _zeros([a[piece] for a in arrays])
            self._project_back(arrays, sums, piece, out)
            use(piece, *out[:5])

        share(some, _pieces(len(sums)))

    def _sums(self, image: np.ndarray, d_image: np.ndarray) -> np.ndarray:
        """What `project_back` makes gradients of, float32 (G, SUMS)."""
        from splatwire.render import _cpu_gradients

        num, width, spare = self.splats.shape[0], _cpu_gradients.SUMS, _cpu_gradients.SPARE
        flat = np.zeros(num * width + spare, np.float32)
        for band in self._bands():
            self._add_gradients(band, image, d_image, flat)
        return flat[: num * width].reshape(num, width)

    def _project_back(
        self, arrays: list[np.ndarray], sums: np.ndarray, piece: slice, results: list[np.ndarray]
    ) -> None:
        from splatwire.render import _cpu_project

        mine = [a[piece] for a in arrays[:4]]
        _cpu_project.project_back(*mine, *self.camera, self.splats[piece], self.tiles[piece], sums[piece], *results)

    def _add_gradients(self, band: _Band, image: np.ndarray, d_image: np.ndarray, sums: np.ndarray) -> None:
        """Adds a band's sums to those of each Gaussian."""
        from splatwire.render import _cpu_gradients

        rows = np.zeros(band.ids.shape[0] * _cpu_gradients.SUMS + _cpu_gradients.SPARE, np.float32)
        lists = (band.starts, band.ids, band.spans, self.grid_x, band.first_row)

        share(
            lambda row: _cpu_gradients.draw_tiles_back(
                self.splats, *lists, image, d_image, rows, row * self.grid_x, (row + 1) * self.grid_x
            ),
            range((band.starts.shape[0] - 1) // self.grid_x),
        )
        share(
            lambda piece: _cpu_gradients.add_rows(
                rows, band.order[piece], band.places, band.place_starts[piece.start : piece.stop + 1], sums
            ),
            _pieces(band.order.shape[0]),
        )

    def _bands(self) -> Iterator[_Band]:
        """Bands of tile rows that together cover the image."""
        return iter(self.kept) if self.kept else (self._fill(number) for number in range(len(self.cuts)))

    def _fill(self, number: int) -> _Band:
        from splatwire.render import _cpu_lists

        first, last = self.cuts[number]
        order, columns = _cpu_lists.depth_order(self.splats, self.tiles, first, last)
        return _Band(first, order, *_cpu_lists.fill_tiles(self.splats, order, columns, self.grid_x, first, last))


def _cache_lines(num: int) -> np.ndarray:
    """Room for splats, each where a cache line begins."""
    from splatwire.render._cpu_project import SPLAT

    room = np.empty((num + 1) * SPLAT, np.float32)
    first = -room.ctypes.data % 64 // 4
    return room[first : first + num * SPLAT].reshape(num, SPLAT)


def _zeros(arrays: list[np.ndarray]) -> list[np.ndarray]:
    """Room for gradients of means, quats, scales, opacities, colors, and of the 2D means."""
    return [*(np.zeros_like(a) for a in arrays), np.zeros((len(arrays[0]), 2), np.float32)]


def _pieces(num: int) -> list[slice]:
    return [slice(first, min(first + _PIECE, num)) for first in range(0, num, _PIECE)]


def _cuts(entries: np.ndarray, num_bands: int) -> list[int]:
    """Tile rows at which a new band starts, and the end: each within `MAX_ENTRIES` or one row."""
    limit = min(MAX_ENTRIES, entries.sum() / num_bands)
    cuts, held = [0], 0.0
    for row, more in enumerate(entries):
        if held + more > limit and row > cuts[-1]:
            cuts.append(row)
            held = 0.0
        held += more
    return [*cuts, len(entries)]


def _camera_arguments(cameras: Cameras, view: int) -> tuple[Any, ...]:
    """Pose, intrinsics, size and constants as the projection kernels take them."""
    pose = np.ascontiguousarray(to_numpy(cameras.viewmats[view]), np.float64)
    K = to_numpy(cameras.Ks[view]).astype(np.float64)
    intrinsics = (float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))
    constants = (NEAR_DEPTH, DILATION, FRUSTUM_MARGIN, float(TILE))
    return pose, intrinsics, cameras.width, cameras.height, constants
