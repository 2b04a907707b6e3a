"""Weights and weighted sums of neighbours in numpy, the reference for the kernels of temporal concealment."""

import numpy as np

from splatwire.concealment.temporal.neighbors import COLOUR, DISTANCE_FLOOR, MAX_WEIGHT_SUM, RIDGES, SHAPE, Neighbors


def plain_smooth_weights(offsets: np.ndarray) -> np.ndarray:
    """Weights of `smooth_weights`, (n, k), from the normal equations of the fit."""
    square = (offsets**2).sum(axis=2)
    scale = square.mean(axis=1, keepdims=True) + 1e-30
    proximity = 1 / (square / scale + DISTANCE_FLOOR)
    proximity /= proximity.sum(axis=1, keepdims=True)
    x, y, z = np.moveaxis(offsets / np.sqrt(scale)[:, :, None], 2, 0)
    terms = np.stack([np.ones_like(x), x, y, z, x * x, y * y, z * z, x * y, x * z, y * z], axis=2)
    moments = np.einsum("nk,nka,nkb->nab", proximity, terms, terms) + np.diag(RIDGES)
    here = np.linalg.solve(moments, np.eye(10)[None, :, :1])[:, :, 0]
    weights = proximity * np.einsum("nka,na->nk", terms, here)
    weights /= weights.sum(axis=1, keepdims=True)
    wild = np.abs(weights).sum(axis=1) > MAX_WEIGHT_SUM
    weights[wild] = proximity[wild]
    return weights


def plain_interpolation(neighbors: Neighbors, values: np.ndarray) -> np.ndarray:
    """Values of the lost tracks, float64 (n, C), as `Neighbors.interpolate` returns them."""
    near = values[neighbors.index].astype(np.float64)
    found = np.einsum("nk,nkc->nc", neighbors.weights, near)
    found[:, SHAPE] = found[:, SHAPE].clip(near[:, :, SHAPE].min(axis=1), near[:, :, SHAPE].max(axis=1))
    share = np.einsum("nka,nka->n", neighbors.contrasts, near[:, :, COLOUR]).clip(-1, 1)
    found[:, COLOUR] = np.einsum("nk,nkc->nc", neighbors.closeness, near[:, :, COLOUR])
    found[:, COLOUR] += share[:, None] * neighbors.contrast
    return found
