"""Explicit Gaussians with view-dependent colour, as in a 3DGS file."""

import dataclasses
import importlib
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from splatwire.arguments import array_of
from splatwire.errors import InvalidValueError, check_kind, whole_number
from splatwire.files.mmap_array import large_empty
from splatwire.ops.sort3 import sort3
from splatwire.ops.spherical_harmonics import degree_of, num_functions, sh_basis
from splatwire.ops.threads import parallel_map
from splatwire.reprs import summary_repr
from splatwire.types.anchors import MIN_SIZE
from splatwire.types.gaussians import Gaussians
from splatwire.types.loss_mask import LossMask
from splatwire.types.origin import Origin, check_origin
from splatwire.types.shapes import Shape, check_arrays, check_mask, indices_of

CHUNK_GAUSSIANS = 1 << 16
"""Number of Gaussians copied at a time."""

_ROUNDING = 4e-3
"""Maximum difference of a unit quaternion's squared length from 1, rounded to float16."""
_SHAPES: dict[str, Shape] = {
    "means": ("G", 3), "quats": ("G", 4), "scales": ("G", 3), "opacities": ("G",), "sh": ("G", "D", 3),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Splats:
    """Attributes of G anisotropic Gaussians. Spherical harmonics describe how the colour depends on the view.

    Attributes:
        means: Centres, world units, relative to the scene's origin.
        quats: Unit quaternions, (w, x, y, z). Functions that take a scene normalise quaternions of other lengths.
        scales: Standard deviations along the principal axes, world units (linear, not logarithms).
        opacities: Opacity at the centre, 0 to 1 (not logits).
        sh: Coefficients of red, green and blue, ordered as in `splatwire.ops.spherical_harmonics`; the colour is 0.5
            plus their sum.
    """

    means: Float[np.ndarray, "G 3"]
    quats: Float[np.ndarray, "G 4"]
    scales: Float[np.ndarray, "G 3"]
    opacities: Float[np.ndarray, "G"]
    sh: Float[np.ndarray, "G D 3"]

    __repr__ = summary_repr

    def __post_init__(self) -> None:
        check_arrays(self, _SHAPES, tensors=False, positions="means")
        degree_of(self.sh.shape[1])

    @property
    def num_gaussians(self) -> int:
        """Number of Gaussians, G."""
        return int(self.means.shape[0])

    @property
    def degree(self) -> int:
        """Degree of the spherical harmonics."""
        return degree_of(self.sh.shape[1])

    @staticmethod
    def empty(count: int, degree: int) -> "Splats":
        """Allocates `count` Gaussians with undefined values."""
        whole_number(count, "count")
        shapes = {"means": (3,), "quats": (4,), "scales": (3,), "opacities": (), "sh": (num_functions(degree), 3)}
        rows = {name: large_empty((count, *shape), np.float32) for name, shape in shapes.items()}
        return Splats(**rows)

    def slice_range(self, begin: int, end: int) -> "Splats":
        """Returns the Gaussians from index `begin` to `end` (exclusive), without copying them.

        Raises:
            InvalidValueError: If an index is negative or not a whole number.
        """
        begin, end = whole_number(begin, "begin"), whole_number(end, "end")
        return Splats(**{f.name: getattr(self, f.name)[begin:end] for f in dataclasses.fields(self)})

    def run(self, begin: int, end: int) -> "Splats":
        """Deprecated name of `slice_range`."""
        warnings.warn("Splats.run is deprecated, use slice_range", DeprecationWarning, stacklevel=2)
        return self.slice_range(begin, end)

    def gathered(self, index: Any) -> "Splats":
        """Returns the Gaussians at `index` (integers, mask or slice), in that order.

        Large arrays of the result are backed by a temporary file, so that the result may be larger than memory.
        """
        indices = indices_of(index, self.num_gaussians)
        result = Splats.empty(len(indices), self.degree)
        for begin in range(0, len(indices), CHUNK_GAUSSIANS):
            result.fill(begin, self.select(indices[begin : begin + CHUNK_GAUSSIANS]))
        return result

    def fill(self, begin: int, source: "Splats") -> None:
        """Overwrites consecutive Gaussians, from index `begin` on, with the Gaussians of `source`, in place.

        Raises:
            InvalidValueError: If `source` has another degree, or more Gaussians than there are from `begin` on.
        """
        check_kind(source, Splats, "open_scene(...).splats", "source")
        capacity = self.num_gaussians - whole_number(begin, "begin")
        if source.num_gaussians > capacity or source.degree != self.degree:
            raise InvalidValueError(
                f"source: {source.num_gaussians:,} Gaussians of degree {source.degree} do not fit in the place of "
                f"{max(capacity, 0):,} of degree {self.degree}"
            )
        for name, values in vars(self.slice_range(begin, begin + source.num_gaussians)).items():
            values[:] = getattr(source, name)

    def select(self, index: Any) -> "Splats":
        """Returns the Gaussians at `index`, in the order of `index`: integers, a slice, or a boolean mask of all G.

        Raises:
            InvalidValueError: If an index is out of range, or a mask has another length.
        """
        indices = indices_of(index, self.num_gaussians)
        # indexing with brackets is several times slower than `take`
        return Splats(**{f.name: getattr(self, f.name).take(indices, axis=0) for f in dataclasses.fields(self)})

    def with_unit_quats(self) -> "Splats":
        """Returns the Gaussians with quaternions of length 1, and with float16 arrays converted to float32.

        Quaternions of length 0 or with invalid values are not changed. If all other quaternions have length 1 within
        rounding, the Gaussians are returned unchanged.
        """
        # Kernels cannot be compiled for float16.
        halves = {name: value.astype(np.float32) for name, value in vars(self).items() if value.dtype == np.float16}
        if halves:
            return dataclasses.replace(self, **halves).with_unit_quats()
        if all(
            _are_unit(self.quats[begin : begin + CHUNK_GAUSSIANS])
            for begin in range(0, self.num_gaussians, CHUNK_GAUSSIANS)
        ):
            return self
        quats = large_empty((self.num_gaussians, 4), np.float32)
        for begin in range(0, self.num_gaussians, CHUNK_GAUSSIANS):
            piece = self.quats[begin : begin + CHUNK_GAUSSIANS].astype(np.float64)
            lengths = np.sqrt(np.einsum("gi,gi->g", piece, piece))[:, None]
            valid = np.isfinite(lengths) & (lengths > 0)
            quats[begin : begin + CHUNK_GAUSSIANS] = np.where(valid, piece / np.where(valid, lengths, 1), piece)
        return dataclasses.replace(self, quats=quats)

    def at_most_degree(self, degree: int) -> "Splats":
        """Returns the Gaussians with spherical harmonics truncated to `degree`.

        Raises:
            InvalidValueError: If the degree is not supported.
        """
        return dataclasses.replace(self, sh=self.sh[:, : num_functions(degree)])

    def moved_origin(self, before: Origin, after: Origin) -> "Splats":
        """Converts positions from coordinates relative to the origin `before` to coordinates relative to `after`.

        Raises:
            InvalidValueError: If an origin is not three finite numbers.
        """
        before, after = check_origin(before), check_origin(after)
        if before == after:
            return self
        shift = np.array(before) - np.array(after)
        means = large_empty((self.num_gaussians, 3), np.float32)
        for begin in range(0, self.num_gaussians, CHUNK_GAUSSIANS):
            means[begin : begin + CHUNK_GAUSSIANS] = (
                self.means[begin : begin + CHUNK_GAUSSIANS].astype(np.float64) + shift
            )
        return dataclasses.replace(self, means=means)

    @property
    def log_axes(self) -> Float[np.ndarray, "G 3"]:
        """Natural logarithms of the standard deviations along the axes, largest first."""
        low, middle, high = sort3(np.log(np.maximum(self.scales, np.float32(MIN_SIZE))))
        return np.stack([high, middle, low], axis=1)

    @property
    def log_sizes(self) -> Float[np.ndarray, "G"]:
        """Logarithm of each Gaussian's size, the geometric mean of its axes."""
        return self.log_axes.mean(axis=1)

    def with_losses(self, fully_received: Bool[np.ndarray, "G"], positions: Float[np.ndarray, "G 3"]) -> "Splats":
        """Simulates losses: moves lost Gaussians to `positions`, and sets the opacity of lost Gaussians to 0.

        Args:
            fully_received: Mask of received Gaussians.
            positions: Positions for the lost Gaussians; other rows are ignored.

        Raises:
            InvalidValueError: If an array has another shape or type.
        """
        check_mask(fully_received, self.num_gaussians, "fully_received")
        array_of(positions, "positions", (self.num_gaussians, 3))
        opacities = np.where(fully_received, self.opacities, np.float32(0))
        return dataclasses.replace(
            self, means=np.where(fully_received[:, None], self.means, positions), opacities=opacities
        )

    def with_estimates(self, loss_mask: LossMask, estimates: "Splats") -> "Splats":
        """Returns the Gaussians with lost ones replaced by estimates.

        Args:
            loss_mask: Mask of received Gaussians.
            estimates: All Gaussians, with estimates of the lost ones.

        Raises:
            InvalidValueError: If an argument has another type, or is for another number of Gaussians.
        """
        check_kind(loss_mask, LossMask, "decode_stream(...).loss_mask", "loss_mask")
        check_kind(estimates, Splats, "open_scene(...).splats", "estimates")
        check_mask(loss_mask.fully_received, self.num_gaussians, "loss_mask")
        if estimates.sh.shape != self.sh.shape:
            raise InvalidValueError(f"estimates: Gaussians with sh {estimates.sh.shape}, not {self.sh.shape}")
        if estimates is self:
            return self
        fully_received, merged = loss_mask.fully_received, {}
        for name, values in vars(self).items():
            merged[name] = np.where(
                fully_received.reshape(-1, *[1] * (values.ndim - 1)), values, getattr(estimates, name)
            )
        return Splats(**merged)

    def seen_from(self, camera_center: Float[np.ndarray, "3"]) -> Gaussians:
        """Returns the Gaussians with the colours seen by a camera at `camera_center`.

        Raises:
            InvalidValueError: If the centre is not three finite numbers.
        """
        viewpoint = array_of(camera_center, "camera_center", (3,))
        with np.errstate(over="ignore"):  # such numbers are refused
            center = np.require(viewpoint, np.float32, ("C", "W"))
        if not np.isfinite(center).all():
            raise InvalidValueError("camera_center: expected three finite numbers in the range of float32")
        colors = _compiled_colors(self, center)
        if colors is None:
            colors = _colors(self, center)
        return Gaussians(self.means, self.quats, self.scales, self.opacities, colors)


def _colors(splats: Splats, camera_center: Float[np.ndarray, "3"]) -> Float[np.ndarray, "G 3"]:
    """Returns the colours that a camera sees, computed by numpy without a compiled kernel."""
    rays = splats.means - camera_center
    with np.errstate(over="ignore"):  # the distance of a very far Gaussian overflows
        distances = np.linalg.norm(rays, axis=1, keepdims=True)
    directions = rays / np.maximum(distances, np.float32(1e-12))
    colors = np.einsum("gd,gdc->gc", sh_basis(directions, splats.degree), splats.sh) + np.float32(0.5)
    return np.maximum(colors, np.float32(0))


def _compiled_colors(splats: Splats, camera_center: Float[np.ndarray, "3"]) -> Float[np.ndarray, "G 3"] | None:
    """Returns the colours that a camera sees, computed by a compiled kernel in parallel; the same as `_colors`.

    The result is None if an array has a type or layout for which the kernel is not compiled.
    """
    # Deferred, because numba takes a second to load, and most users of Gaussians need no colours.
    view_colours = importlib.import_module("splatwire.ops._colour_kernels").view_colours

    arrays = splats.means, splats.sh, camera_center
    if not all(a.dtype == np.float32 and a.flags.c_contiguous and a.flags.writeable for a in arrays):
        return None
    colors = np.empty((splats.num_gaussians, 3), np.float32)

    def color_slice(begin: int) -> None:
        rows, basis = slice(begin, begin + CHUNK_GAUSSIANS), np.empty(16, np.float32)
        view_colours(splats.means[rows], splats.sh[rows], camera_center, basis, colors[rows])

    parallel_map(color_slice, range(0, splats.num_gaussians, CHUNK_GAUSSIANS))
    return colors


def _are_unit(quats: Float[np.ndarray, "G 4"]) -> bool:
    """True if all quaternions have length 1, within the rounding of float16.

    Quaternions of length 0 and quaternions with values that are not finite are ignored.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        squares = np.einsum("gi,gi->g", quats, quats, dtype=np.float64, casting="safe")
        return not (np.abs(squares - 1) > _ROUNDING)[np.isfinite(squares) & (squares > 0)].any()
