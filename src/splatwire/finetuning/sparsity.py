"""Penalty on the estimated bits of spherical harmonics, a term of the loss of fine-tuning."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32

from splatwire.codec.gaussians.attributes import LUMA_CHROMA
from splatwire.codec.gaussians.layout import BITS, STEP_BITS, STEP_HARMONICS, TRANSFORM_UNIT
from splatwire.finetuning.latents import map_slices
from splatwire.types import SplatCoding

WEIGHT = 0.3
"""Factor on the mean cost of the Gaussians. The loss of the pictures is about 1 at the start of the fine-tuning."""


@dataclass(frozen=True, eq=False)
class HarmonicCost:
    """Term of the training loss that makes harmonics above degree 0 cheap to encode.

    The term is roughly proportional to the number of bits that these harmonics take in a stream. A coefficient `u` with
    the quantisation step `s` costs `log(1 + |u| / s)`.

    Attributes:
        transform: Matrix that converts a Gaussian's harmonics, flattened from (K, 3), to the coefficients that the
            codec quantises; C = 3 K.
        steps: Quantisation step of the coefficients of each Gaussian.
    """

    # The gradient of the cost is largest near 0, so that coefficients with little effect become 0, and large ones
    # are hardly changed.

    transform: Float32[np.ndarray, "C C"]
    steps: Float32[np.ndarray, "N 1"]

    @staticmethod
    def of(coding: SplatCoding) -> "HarmonicCost":
        """Creates the penalty on spherical harmonics for a stream with the given quantisation parameters.

        Args:
            coding: Quantisation parameters of the stream. Its quantisation steps and its transform of harmonics are
                used.
        """
        transform = np.kron(np.linalg.inv(coding.transform / TRANSFORM_UNIT), LUMA_CHROMA.T)
        exponents = coding.base_exponents[STEP_HARMONICS] + (coding.precision_classes.astype(np.int64) << STEP_BITS)
        rounded_exponents = np.clip((exponents + (1 << (STEP_BITS - 1))) >> STEP_BITS, 2, BITS)
        return HarmonicCost(transform.astype(np.float32), np.exp2(-rounded_exponents).astype(np.float32)[:, None])

    def value(self, harmonics: Float[np.ndarray, "N K 3"]) -> float:
        """Returns the loss term: the mean cost of a Gaussian's harmonics, multiplied by the constant `WEIGHT`."""

        def cost(rows: slice) -> float:
            coefficients = self._coefficients(harmonics[rows])
            return float(np.log1p(np.abs(coefficients) / self.steps[rows]).sum(dtype=np.float64))

        return WEIGHT * math.fsum(map_slices(len(harmonics), cost)) / len(harmonics)

    def gradient(self, harmonics: Float[np.ndarray, "N K 3"]) -> Float[np.ndarray, "N K 3"]:
        """Returns the gradient of the loss term (`value`) with respect to the harmonics."""
        # Coefficients that are 0 have none.
        result, weight = np.empty(harmonics.shape, np.float32), np.float32(WEIGHT / len(harmonics))

        def fill(rows: slice) -> None:
            coefficients = self._coefficients(harmonics[rows])
            slopes = np.sign(coefficients) * weight / (self.steps[rows] + np.abs(coefficients))
            result[rows] = (slopes @ self.transform.T).reshape(result[rows].shape)

        map_slices(len(harmonics), fill)
        return result

    def _coefficients(self, harmonics: Float[np.ndarray, "N K 3"]) -> Float[np.ndarray, "N C"]:
        return harmonics.reshape(len(harmonics), -1) @ self.transform
