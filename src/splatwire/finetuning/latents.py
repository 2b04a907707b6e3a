"""Trainable parameters of explicit Gaussians, and back-propagation to these parameters."""

# Functions of all Gaussians work on pieces that stay in the processor's cache, on all threads. The results do
# not depend on the number of threads.

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from splatwire.codec.gaussians.attributes import matrices_of
from splatwire.ops.quaternions import quaternions_of
from splatwire.ops.spherical_harmonics import sh_basis
from splatwire.ops.threads import Result, parallel_map
from splatwire.types import Gaussians
from splatwire.types.splats import Splats

_PIECE = 4096
"""Number of Gaussians per piece."""

_MIN_OPACITY, _MAX_OPACITY = 1e-3, 0.9998
"""Range of initial opacities; a logit of 0 or 1 would be infinite."""


@dataclass(eq=False)
class Latents:
    """Trainable parameters of N Gaussians, changed in place by the optimiser.

    Attributes:
        displacements: Displacements of the centres, in units of each Gaussian's size (`units`).
        rotations: Rotations about the principal axes of each Gaussian, radians; 0 between optimisation steps.
        logs: Natural logarithms of the standard deviations.
        logits: Logits of the opacities.
        base: Harmonics of degree 0.
        harmonics: Harmonics above degree 0.
        centres: Centres without displacements, world units, relative to the scene's origin.
        units: Geometric mean of the two largest standard deviations of each Gaussian at the start, world units.
        quats: Unit quaternions, (w, x, y, z).
    """

    # After each step, `apply_rotations` applies the rotations to `quats`, so that the parameters stay small and
    # independent.

    displacements: Float[np.ndarray, "N 3"]
    rotations: Float[np.ndarray, "N 3"]
    logs: Float[np.ndarray, "N 3"]
    logits: Float[np.ndarray, "N"]
    base: Float[np.ndarray, "N 3"]
    harmonics: Float[np.ndarray, "N K 3"]
    centres: Float[np.ndarray, "N 3"]
    units: Float[np.ndarray, "N"]
    quats: Float[np.ndarray, "N 4"]

    @staticmethod
    def of(splats: Splats) -> "Latents":
        """Converts Gaussians to the parameters of the fine-tuning."""
        logs = np.ascontiguousarray(np.log(np.maximum(splats.scales, np.float32(1e-12))))
        ordered = np.sort(logs, axis=1)
        zeros = np.zeros(splats.means.shape, np.float32)
        return Latents(
            zeros,
            zeros.copy(),
            logs,
            _logit(splats.opacities, _MIN_OPACITY),
            splats.sh[:, 0].copy(),
            splats.sh[:, 1:].copy(),
            splats.means.copy(),
            np.exp(ordered[:, 1:].mean(axis=1)),
            _unit(np.ascontiguousarray(splats.quats)),
        )

    def copy(self) -> "Latents":
        """Returns a copy that shares no arrays."""
        return Latents(**{name: values.copy() for name, values in vars(self).items()})

    def trained(self) -> dict[str, np.ndarray]:
        """Returns the trained parameter arrays by name.

        The arrays are not copied; changing an array changes the parameters.
        """
        names = ("displacements", "rotations", "logs", "logits", "base", "harmonics")
        return {name: getattr(self, name) for name in names if getattr(self, name).size}

    def apply_rotations(self) -> None:
        """Applies `rotations` to `quats`, then sets `rotations` to 0."""

        def apply(rows: slice) -> None:
            self.quats[rows] = _unit(_product(self.quats[rows], _rotation(self.rotations[rows])))
            self.rotations[rows] = 0

        map_slices(len(self.quats), apply)

    def splats(self, rounding_errors: "RoundingErrors | None" = None) -> Splats:
        """Returns the Gaussians that these parameters describe, with or without simulated quantisation.

        Args:
            rounding_errors: Rounding errors to add to the parameters, so that the result is what a decoder would
                obtain; None for exact Gaussians.
        """
        # In main memory, as the parameters: each iteration would write a temporary file for `Splats.empty`.
        shapes, count = ((3,), (4,), (3,), (), (1 + self.harmonics.shape[1], 3)), len(self.centres)
        result = Splats(*(np.empty((count, *shape), np.float32) for shape in shapes))

        def fill(rows: slice) -> None:
            errors = None if rounding_errors is None else rounding_errors.select(rows)
            result.fill(rows.start, self.select(rows)._splats_single_thread(errors))

        map_slices(len(self.centres), fill)
        return result

    def _splats_single_thread(self, rounding_errors: "RoundingErrors | None") -> Splats:
        """Returns the Gaussians that these parameters describe, in a single thread (see `splats`)."""
        means, logs, quats = self.centres + self.units[:, None] * self.displacements, self.logs, self.quats
        logits, base, harmonics = self.logits, self.base, self.harmonics
        if rounding_errors is not None:
            means, logs, quats = (
                means + rounding_errors.means,
                logs + rounding_errors.logs,
                _unit(_product(quats, rounding_errors.quats)),
            )
            logits, base = logits + rounding_errors.logits, base + rounding_errors.base
            harmonics = harmonics + rounding_errors.harmonics
        opacities = np.float32(1) / (np.float32(1) + np.exp(-logits))
        sh = np.concatenate([base[:, None], harmonics], axis=1)
        return Splats(means, quats, np.exp(logs), opacities, sh)

    def select(self, index: np.ndarray | slice) -> "Latents":
        """Returns the parameters of some of the Gaussians, given by their indices."""
        return Latents(**{name: values[index] for name, values in vars(self).items()})


@dataclass(frozen=True, eq=False)
class RoundingErrors:
    """Rounding errors of the trainable parameters of Gaussians: differences between rounded and exact values.

    Attributes:
        means: Displacement of the centres, world units.
        logs: Difference of the logarithms of the standard deviations.
        quats: Rotation from the exact to the rounded Gaussian, relative to the principal axes of the exact Gaussian.
        logits: Difference of the logits of the opacities.
        base: Difference of the harmonics of degree 0.
        harmonics: Difference of the harmonics above degree 0.
    """

    means: Float[np.ndarray, "N 3"]
    logs: Float[np.ndarray, "N 3"]
    quats: Float[np.ndarray, "N 4"]
    logits: Float[np.ndarray, "N"]
    base: Float[np.ndarray, "N 3"]
    harmonics: Float[np.ndarray, "N K 3"]

    @staticmethod
    def between(exact: Splats, rounded: Splats) -> "RoundingErrors":
        """Computes rounding errors: the differences between the parameters of rounded and of exact Gaussians.

        Adding the differences to the exact parameters gives the rounded Gaussians.
        """
        parts = map_slices(
            exact.num_gaussians,
            lambda rows: RoundingErrors._between_single_thread(
                exact.slice_range(rows.start, rows.stop), rounded.slice_range(rows.start, rows.stop)
            ),
        )
        return RoundingErrors(
            **{name: np.concatenate([getattr(each, name) for each in parts]) for name in vars(parts[0])}
        )

    @staticmethod
    def _between_single_thread(exact: Splats, rounded: Splats) -> "RoundingErrors":
        """Computes the rounding errors of Gaussians in a single thread (see `between`)."""
        # A Gaussian has several equivalent forms, with its axes in another order or with other signs. The form
        # of the rounded Gaussian that is closest to the exact one is used.
        order = np.argsort(-exact.scales, axis=1, kind="stable")
        rank = np.argsort(order, axis=1, kind="stable")
        scales = np.take_along_axis(rounded.scales, rank, axis=1)
        matrices = matrices_of(exact.quats.astype(np.float64))
        axes = np.take_along_axis(matrices_of(rounded.quats.astype(np.float64)), rank[:, None, :], axis=2)
        along = np.einsum("nij,nij->nj", matrices, axes)
        axes *= np.where(along < 0, -1.0, 1.0)[:, None, :]
        mirrored = np.flatnonzero(np.linalg.det(axes) < 0)
        axes[mirrored, :, np.abs(along[mirrored]).argmin(axis=1)] *= -1
        relative = np.einsum("nji,njk->nik", matrices, axes)
        return RoundingErrors(
            rounded.means - exact.means,
            np.log(np.maximum(scales, np.float32(1e-12)) / np.maximum(exact.scales, np.float32(1e-12))),
            quaternions_of(relative).astype(np.float32),
            _logit(rounded.opacities) - _logit(exact.opacities),
            rounded.sh[:, 0] - exact.sh[:, 0],
            rounded.sh[:, 1:] - exact.sh[:, 1:],
        )

    def select(self, index: slice) -> "RoundingErrors":
        """Returns the rounding errors of the Gaussians in a range."""
        return RoundingErrors(**{name: values[index] for name, values in vars(self).items()})


@dataclass(frozen=True, eq=False)
class Gradients:
    """Gradients of the loss with respect to the attributes of Gaussians, as the rasteriser returns them.

    Attributes:
        means: With respect to the centres.
        quats: With respect to the unit quaternions.
        scales: With respect to the standard deviations.
        opacities: With respect to the opacities.
        sh: With respect to the spherical harmonics.
    """

    means: Float[np.ndarray, "N 3"]
    quats: Float[np.ndarray, "N 4"]
    scales: Float[np.ndarray, "N 3"]
    opacities: Float[np.ndarray, "N"]
    sh: Float[np.ndarray, "N D 3"]


def gradients_of(
    latents: Latents, decoded: Splats, rounding_errors: RoundingErrors | None, decoded_gradients: Gradients
) -> dict[str, Float[np.ndarray, "..."]]:
    """Back-propagates gradients from the decoded Gaussians to the trainable parameters.

    Rounding is treated as the identity function (straight-through).

    Args:
        latents: The trainable parameters. `latents.rotations` must be 0.
        decoded: The decoded Gaussians, `latents.splats(rounding_errors)`.
        rounding_errors: Differences between rounded and exact parameters, which count as constants; None without
            rounding.
        decoded_gradients: Gradients with respect to the decoded Gaussians.

    Returns:
        Gradient with respect to each array of `Latents.trained`, by name.
    """
    gradients = {
        name: np.empty_like(getattr(latents, name)) for name in ("displacements", "rotations", "logs", "logits")
    }

    def fill(rows: slice) -> None:
        quats = decoded_gradients.quats[rows]
        if rounding_errors is not None:
            quats = _product(quats, _conjugate(rounding_errors.quats[rows]))
        gradients["rotations"][rows] = _product(_conjugate(latents.quats[rows]), quats)[:, 1:] * np.float32(0.5)
        opacities = decoded.opacities[rows]
        gradients["displacements"][rows] = decoded_gradients.means[rows] * latents.units[rows, None]
        gradients["logs"][rows] = decoded_gradients.scales[rows] * decoded.scales[rows]
        gradients["logits"][rows] = decoded_gradients.opacities[rows] * (opacities * (1 - opacities))

    map_slices(len(latents.quats), fill)
    gradients |= {"base": decoded_gradients.sh[:, 0], "harmonics": decoded_gradients.sh[:, 1:]}
    return {name: gradients[name] for name in latents.trained()}


def map_slices(count: int, work: Callable[[slice], Result]) -> list[Result]:
    """Divides Gaussians into consecutive ranges, and applies a function to all ranges in parallel threads.

    Args:
        count: Number of Gaussians, at least 1.
        work: Function, called with each range of indices as a slice.

    Returns:
        The results, in the order of the Gaussians.
    """
    return parallel_map(work, [slice(first, min(first + _PIECE, count)) for first in range(0, count, _PIECE)])


def harmonic_gradient(
    splats: Splats, seen: Gaussians, camera_center: Float[np.ndarray, "3"], colors: Float[np.ndarray, "N 3"]
) -> Float[np.ndarray, "N D 3"]:
    """Back-propagates the gradient from the colours of Gaussians in a view to their spherical harmonics.

    Args:
        splats: The Gaussians.
        seen: The Gaussians as seen in the view.
        camera_center: Position of the camera.
        colors: Gradient with respect to the colours.
    """
    # Viewing directions are treated as constants, because fine-tuning hardly moves the centres of Gaussians.
    # Colours clipped at 0 have no gradient.
    gradient = np.empty(splats.sh.shape, np.float32)

    def fill(rows: slice) -> None:
        rays = splats.means[rows] - camera_center
        directions = rays / np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), np.float32(1e-12))
        slopes = np.where(seen.colors[rows] > 0, colors[rows], np.float32(0))
        np.multiply(sh_basis(directions, splats.degree)[:, :, None], slopes[:, None, :], out=gradient[rows])

    map_slices(splats.num_gaussians, fill)
    return gradient


def _logit(opacities: np.ndarray, least: float = 1e-6) -> np.ndarray:
    clipped = np.clip(opacities, np.float32(least), np.float32(_MAX_OPACITY))
    return np.log(clipped / (1 - clipped))


def _unit(quats: np.ndarray) -> np.ndarray:
    return quats / np.maximum(np.linalg.norm(quats, axis=1, keepdims=True), np.float32(1e-12))


def _conjugate(quats: np.ndarray) -> np.ndarray:
    return quats * np.array([1, -1, -1, -1], np.float32)


def _rotation(rotations: np.ndarray) -> np.ndarray:
    """Returns the unit quaternions of small rotations, given as rotation vectors (N, 3)."""
    return _unit(np.concatenate([np.ones_like(rotations[:, :1]), rotations / 2], axis=1))


def _product(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Multiplies quaternions, (N, 4) each."""
    a, b, c, d = p.T
    e, f, g, h = q.T
    return np.stack(
        [
            a * e - b * f - c * g - d * h,
            a * f + b * e + c * h - d * g,
            a * g - b * h + c * e + d * f,
            a * h + b * g - c * f + d * e,
        ],
        axis=1,
    )
