"""Explicit Gaussians whose colour is a function of the viewing direction: what a 3DGS file holds."""

import dataclasses
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from splatwire.files.large import large_empty
from splatwire.ops.rising import rising
from splatwire.ops.spherical_harmonics import degree_of, num_functions, sh_basis
from splatwire.reprs import summary_repr
from splatwire.scene.anchors import MIN_SIZE
from splatwire.scene.erasures import Erasures
from splatwire.scene.gaussians import Gaussians
from splatwire.scene.origin import Origin
from splatwire.scene.shapes import Shape, check_arrays

ROWS = 1 << 16
"""So many rows are copied at a time."""

_SHAPES: dict[str, Shape] = {
    "means": ("G", 3), "quats": ("G", 4), "scales": ("G", 3), "opacities": ("G",), "sh": ("G", "D", 3),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Splats:
    """G anisotropic Gaussians with spherical harmonics for colour; nothing else depends on the view.

    Attributes:
        means: World coordinates of the centres.
        quats: Unit quaternions, (w, x, y, z).
        scales: Standard deviations along the principal axes, world units (linear, not logarithms).
        opacities: Opacity at the centre, in (0, 1) (not logits).
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
        check_arrays(self, _SHAPES, tensors=False)
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
        """Room for so many Gaussians, in a temporary file where it is large; what is there is undefined."""
        shapes = {"means": (3,), "quats": (4,), "scales": (3,), "opacities": (), "sh": (num_functions(degree), 3)}
        rows = {name: large_empty((count, *shape), np.float32) for name, shape in shapes.items()}
        return Splats(**rows)

    def run(self, begin: int, end: int) -> "Splats":
        """The Gaussians from one place to another; they share their memory with these."""
        return Splats(**{f.name: getattr(self, f.name)[begin:end] for f in dataclasses.fields(self)})

    def gathered(self, index: np.ndarray) -> "Splats":
        """Does as `select` for many Gaussians; the result is allocated by `empty`."""
        places = np.flatnonzero(index) if index.dtype == np.bool_ else index
        found = Splats.empty(len(places), self.degree)
        for begin in range(0, len(places), ROWS):
            found.fill(begin, self.select(places[begin : begin + ROWS]))
        return found

    def fill(self, begin: int, some: "Splats") -> None:
        """Writes Gaussians to a place on, into the memory of these."""
        for name, values in vars(self.run(begin, begin + some.num_gaussians)).items():
            values[:] = getattr(some, name)

    def select(self, index: np.ndarray) -> "Splats":
        """Returns the Gaussians at `index` (integers or a boolean mask over G), in that order."""
        places = np.flatnonzero(index) if index.dtype == np.bool_ else index
        # brackets take several times as long
        return Splats(**{f.name: getattr(self, f.name).take(places, axis=0) for f in dataclasses.fields(self)})

    def at_most_degree(self, degree: int) -> "Splats":
        """Returns the Gaussians without the spherical harmonics above a degree.

        Raises:
            InvalidValueError: If there is no such degree.
        """
        return dataclasses.replace(self, sh=self.sh[:, : num_functions(degree)])

    def moved_origin(self, before: Origin, after: Origin) -> "Splats":
        """Returns the Gaussians with positions relative to `after`, given those relative to `before`.

        Sums are made in float64 and rounded once.
        """
        if before == after:
            return self
        shift = np.array(before) - np.array(after)
        means = large_empty((self.num_gaussians, 3), np.float32)
        for begin in range(0, self.num_gaussians, ROWS):
            means[begin : begin + ROWS] = self.means[begin : begin + ROWS].astype(np.float64) + shift
        return dataclasses.replace(self, means=means)

    @property
    def log_axes(self) -> Float[np.ndarray, "G 3"]:
        """Logarithms of the standard deviations along the axes, largest first."""
        low, middle, high = rising(np.log(np.maximum(self.scales, np.float32(MIN_SIZE))))
        return np.stack([high, middle, low], axis=1)

    @property
    def log_sizes(self) -> Float[np.ndarray, "G"]:
        """Logarithm of the size of each, the geometric mean of its axes."""
        return self.log_axes.mean(axis=1)

    def arrived(self, known: Bool[np.ndarray, "G"], places: Float[np.ndarray, "G 3"]) -> "Splats":
        """Returns what a receiver has when only some of them came; lost ones look as they did, and have no opacity."""
        opacities = np.where(known, self.opacities, np.float32(0))
        return dataclasses.replace(self, means=np.where(known[:, None], self.means, places), opacities=opacities)

    def kept(self, erasures: Erasures, proposed: "Splats") -> "Splats":
        """Returns those of these that were received, and the rest of `proposed`."""
        if proposed is self:
            return self
        known, merged = erasures.known, {}
        for name, own in vars(self).items():
            merged[name] = np.where(known.reshape(-1, *[1] * (own.ndim - 1)), own, getattr(proposed, name))
        return Splats(**merged)

    def seen_from(self, camera_center: Float[np.ndarray, "3"]) -> Gaussians:
        """Returns the Gaussians with the colours that a camera at `camera_center` sees.

        Colours are cut at 0, as every 3DGS renderer does, and may exceed 1.
        """
        rays = self.means - camera_center
        with np.errstate(over="ignore"):  # a Gaussian too far away has no direction
            distances = np.linalg.norm(rays, axis=1, keepdims=True)
        directions = rays / np.maximum(distances, np.float32(1e-12))
        colors = np.einsum("gd,gdc->gc", sh_basis(directions, self.degree), self.sh) + np.float32(0.5)
        return Gaussians(self.means, self.quats, self.scales, self.opacities, np.maximum(colors, np.float32(0)))
