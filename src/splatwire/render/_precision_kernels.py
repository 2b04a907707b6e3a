"""Compiled sum of squared gradients of pictures, for each Gaussian and each attribute of its."""

from typing import no_type_check

import numpy as np

from splatwire.ops.compiled import njit

POSITION, SCALE, DIRECTION, SPIN, OPACITY, COLOUR, NUM_SUMS = 0, 1, 4, 5, 6, 7, 8
"""Columns of the sums; those of the three scales, the longest axis first, follow each other."""


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def add_squared(
    means, rotations, scales, opacities, colors, splat_scales, quats, levels, order, spun, sums, first, last
):
    """Adds one picture's gradients, squared, to the `sums` (N, 8) of the Gaussians [first, last).

    Gradients are those by centres (N, 3), rotations (N, 4), scales (N, 3), opacities (N) and colours (N, 3). Of the
    Gaussians there are scales, unit quaternions (w first), opacities (`levels`), their axes with the longest first
    (`order`), and which of these a turn about is a spin: 2 for flat ones, 0 for long ones (`spun`).
    """
    for i in range(first, last):
        something = abs(opacities[i])
        for axis in range(3):
            something += abs(means[i, axis]) + abs(scales[i, axis]) + abs(colors[i, axis])
        for axis in range(4):
            something += abs(rotations[i, axis])
        if something == 0:  # hidden, as most are
            continue
        a, b = np.float64(rotations[i, 0]), np.float64(rotations[i, 1])
        c, d = np.float64(rotations[i, 2]), np.float64(rotations[i, 3])
        w, x, y, z = np.float64(quats[i, 0]), np.float64(quats[i, 1]), np.float64(quats[i, 2]), np.float64(quats[i, 3])
        turned = (
            (-a * x + b * w + c * z - d * y) / 2,  # the derivative by a turn about the Gaussian's own first axis
            (-a * y - b * z + c * w + d * x) / 2,
            (-a * z + b * y - c * x + d * w) / 2,
        )
        away, bright, turns = 0.0, 0.0, 0.0
        for axis in range(3):
            away += np.float64(means[i, axis]) ** 2
            bright += np.float64(colors[i, axis]) ** 2
            turns += turned[axis] ** 2
            longest = order[i, axis]
            sums[i, SCALE + axis] += (np.float64(scales[i, longest]) * np.float64(splat_scales[i, longest])) ** 2
        spin = turned[order[i, spun[i]]] ** 2
        sums[i, POSITION] += away / 3
        sums[i, DIRECTION] += (turns - spin) / 2
        sums[i, SPIN] += spin
        sums[i, OPACITY] += (np.float64(opacities[i]) * np.float64(levels[i])) ** 2
        sums[i, COLOUR] += bright
