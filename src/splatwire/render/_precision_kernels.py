"""Compiled kernel that measures how strongly pictures depend on each attribute of each Gaussian."""

from typing import no_type_check

import numpy as np

from splatwire.ops.compiled import njit

POSITION, SCALE, DIRECTION, SPIN, OPACITY, COLOUR, NUM_SUMS = 0, 1, 4, 5, 6, 7, 8
"""Columns of the sums; the three scales are consecutive, longest axis first."""


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def add_squared(
    d_means,
    d_quats,
    d_scales,
    d_opacities,
    d_colors,
    scales,
    quats,
    opacities,
    order,
    symmetry_axis,
    sums,
    first,
    last,
):
    """Adds the squared gradient with respect to each attribute of each Gaussian to `sums`.

    For scales and opacities, this is the gradient with respect to their natural logarithm. For positions and
    directions, the mean over the axes is added; for colours, the sum over the channels.

    Args:
        d_means: Gradients with respect to the centres.
        d_quats: Gradients with respect to the quaternions.
        d_scales: Gradients with respect to the standard deviations.
        d_opacities: Gradients with respect to the opacities.
        d_colors: Gradients with respect to the colours.
        scales: Standard deviations of the Gaussians.
        quats: Unit quaternions of the Gaussians, (w, x, y, z).
        opacities: Opacities of the Gaussians.
        order: Axes of each Gaussian sorted by length, longest first.
        symmetry_axis: Column of `order` with the axis of symmetry of each Gaussian: 2 (shortest axis) for flat
            Gaussians, 0 (longest axis) for long ones.
        sums: Sums to increase, (N, 8). The constants `POSITION` to `COLOUR` are the index of each attribute's first
            column.
        first: Index of the first Gaussian.
        last: End of the Gaussians (exclusive).
    """
    # The sums measure how strongly images depend on the attributes. Rotations have two parts: spin, a rotation
    # about the axis of symmetry of a flat or a long Gaussian, and changes of direction of this axis.
    for i in range(first, last):
        magnitude = abs(d_opacities[i])
        for axis in range(3):
            magnitude += abs(d_means[i, axis]) + abs(d_scales[i, axis]) + abs(d_colors[i, axis])
        for axis in range(4):
            magnitude += abs(d_quats[i, axis])
        if magnitude == 0:  # most Gaussians are hidden
            continue
        a, b = np.float64(d_quats[i, 0]), np.float64(d_quats[i, 1])
        c, d = np.float64(d_quats[i, 2]), np.float64(d_quats[i, 3])
        w, x, y, z = np.float64(quats[i, 0]), np.float64(quats[i, 1]), np.float64(quats[i, 2]), np.float64(quats[i, 3])
        about_axis = (
            (-a * x + b * w + c * z - d * y) / 2,  # derivative for a rotation about the first axis
            (-a * y - b * z + c * w + d * x) / 2,
            (-a * z + b * y - c * x + d * w) / 2,
        )
        position, colour, rotation = 0.0, 0.0, 0.0
        for axis in range(3):
            position += np.float64(d_means[i, axis]) ** 2
            colour += np.float64(d_colors[i, axis]) ** 2
            rotation += about_axis[axis] ** 2
            longest = order[i, axis]
            sums[i, SCALE + axis] += (np.float64(d_scales[i, longest]) * np.float64(scales[i, longest])) ** 2
        spin = about_axis[order[i, symmetry_axis[i]]] ** 2
        sums[i, POSITION] += position / 3
        sums[i, DIRECTION] += (rotation - spin) / 2
        sums[i, SPIN] += spin
        sums[i, OPACITY] += (np.float64(d_opacities[i]) * np.float64(opacities[i])) ** 2
        sums[i, COLOUR] += colour
