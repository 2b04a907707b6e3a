"""Compiled Adam. What it must compute is in `splatwire.train.adam`."""

import math
from typing import no_type_check

import numpy as np
from numba import prange

from splatwire.ops.compiled import njit

_CHUNK = 1 << 14


@njit(error_model="numpy")
@no_type_check
def _update_run(p, g, m, v, begin, end, step_size, inverse_root, beta1, beta2, epsilon):
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
    """Updates parameter `p` and moments `m`, `v` (flat float32) with gradient `g`."""
    chunks = (p.shape[0] + _CHUNK - 1) // _CHUNK
    rate, inverse = np.float32(step_size), np.float32(1 / root)
    b1, b2, eps = np.float32(beta1), np.float32(beta2), np.float32(epsilon)
    for c in prange(chunks):
        _update_run(p, g, m, v, c * _CHUNK, min((c + 1) * _CHUNK, p.shape[0]), rate, inverse, b1, b2, eps)
