"""Numba kernels of the integer networks, except for the matrix products: bias, rounding, activation, clipping.

Integers are stored as float64, which represents all of them exactly.
"""
# `tests/reference/hacpp_params.py` is an equivalent implementation in plain torch.

from typing import no_type_check

import numpy as np

from splatwire.codec.fixed_point import (
    ACTIVATION_BITS,
    ACTIVATION_LIMIT,
    FACTOR_BITS,
    OUTPUT_BITS,
    OUTPUT_LIMIT,
    WEIGHT_EXPONENT,
)
from splatwire.ops.compiled import njit

TO_ACTIVATION = 2.0**-WEIGHT_EXPONENT
TO_OUTPUT = 2.0 ** (OUTPUT_BITS - ACTIVATION_BITS - WEIGHT_EXPONENT)
LEAK = 655 / 65536
ACTIVATION_MAX = float(ACTIVATION_LIMIT)
OUTPUT_MAX = float(OUTPUT_LIMIT)


@njit(borrows=True, nogil=True)
@no_type_check
def finish_hidden(sums, bias, leaky):
    """Completes a hidden layer in place after the matrix product: adds bias, rounds, applies (leaky) ReLU, clips.

    Args:
        sums: Results of the matrix product, (N, hidden); overwritten by the outputs of the layer.
        bias: Bias of the layer, (hidden).
        leaky: True for a leaky ReLU, False for a ReLU.
    """
    leak = LEAK if leaky else 0.0
    for n in range(sums.shape[0]):
        for c in range(sums.shape[1]):
            value = np.floor((sums[n, c] + bias[c]) * TO_ACTIVATION)
            below = np.floor(value * leak)
            value = value if value > 0.0 else below
            sums[n, c] = min(max(value, -ACTIVATION_MAX), ACTIVATION_MAX)


@njit(borrows=True, nogil=True)
@no_type_check
def finish_output(sums, bias, out):
    """Completes an output layer after the matrix product: bias, rounding to output precision, clipping.

    Args:
        sums: Results of the matrix product, (N, out).
        bias: Bias of the layer, (out).
        out: Output: results of the network, int32 (N, out).
    """
    for n in range(sums.shape[0]):
        for c in range(sums.shape[1]):
            value = np.floor((sums[n, c] + bias[c]) * TO_OUTPUT)
            out[n, c] = np.int32(min(max(value, -OUTPUT_MAX), OUTPUT_MAX))


@njit(borrows=True, nogil=True)
@no_type_check
def to_inputs(outputs, inputs):
    """Converts outputs of a network to inputs of the next network, which have fewer fractional bits.

    Args:
        outputs: Outputs of the first network, (N, outputs).
        inputs: Output: the first columns of `outputs`, converted, (N, columns).
    """
    for n in range(inputs.shape[0]):
        for c in range(inputs.shape[1]):
            inputs[n, c] = outputs[n, c] >> (OUTPUT_BITS - ACTIVATION_BITS)


@njit(borrows=True, nogil=True)
@no_type_check
def feature_activations(symbols, factors, base, activations):
    """Converts decoded feature symbols to network inputs.

    Args:
        symbols: Features in quantisation steps, (N, channels).
        factors: Factor on the quantisation step of each anchor, (N).
        base: Base quantisation step, 16 fractional bits. The quantisation step of an anchor is this step times the
            anchor's factor.
        activations: Output: network inputs, (N, channels).
    """
    for n in range(symbols.shape[0]):
        step = (factors[n] * base) >> (FACTOR_BITS - 4)  # 20 fractional bits
        for c in range(symbols.shape[1]):
            value = (np.int64(symbols[n, c]) * step) >> (20 - ACTIVATION_BITS)
            activations[n, c] = min(max(value, -ACTIVATION_LIMIT), ACTIVATION_LIMIT)
