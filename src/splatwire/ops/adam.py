"""Compiled kernels of Adam."""

import math
from typing import no_type_check

import numpy as np
from numba import prange

from splatwire.ops.compiled import njit

_CHUNK = 1 << 14


@njit(nogil=True, error_model="numpy")
@no_type_check
def update_run(p, g, m, v, begin, end, step_size, inverse_root, beta1, beta2, epsilon):
    """Updates the values from `begin` to `end` of a parameter by one step of Adam, in place, single-threaded.

    Args:
        p: The parameter, flat, float32.
        g: Gradient of the parameter, flat, float32.
        m: First moment, flat, float32; updated.
        v: Second moment, flat, float32; updated.
        begin: Index of the first value.
        end: End of the values (exclusive).
        step_size: Learning rate divided by `1 - beta1 ** t`, float32.
        inverse_root: `1 / sqrt(1 - beta2 ** t)`, float32.
        beta1: Decay rate of the first moment, float32.
        beta2: Decay rate of the second moment, float32.
        epsilon: Number that prevents division by zero, float32.
    """
    one = np.float32(1)
    for i in range(begin, end):
        grad = g[i]
        first = m[i] + (grad - m[i]) * (one - beta1)
        second = v[i] * beta2 + grad * grad * (one - beta2)
        m[i], v[i] = first, second
        p[i] -= step_size * first / (math.sqrt(second) * inverse_root + epsilon)


@njit(parallel=True)
@no_type_check
def update(p, g, m, v, step_size, root, beta1, beta2, epsilon):
    """Updates a parameter by step t of Adam, in place.

    Args:
        p: The parameter, flat, float32.
        g: Gradient of the parameter, flat, float32.
        m: First moment, flat, float32; updated.
        v: Second moment, flat, float32; updated.
        step_size: Learning rate divided by `1 - beta1 ** t`.
        root: `sqrt(1 - beta2 ** t)`.
        beta1: Decay rate of the first moment.
        beta2: Decay rate of the second moment.
        epsilon: Number that prevents division by zero.
    """
    chunks = (p.shape[0] + _CHUNK - 1) // _CHUNK
    rate, inverse = np.float32(step_size), np.float32(1 / root)
    b1, b2, eps = np.float32(beta1), np.float32(beta2), np.float32(epsilon)
    for c in prange(chunks):
        update_run(p, g, m, v, c * _CHUNK, min((c + 1) * _CHUNK, p.shape[0]), rate, inverse, b1, b2, eps)
