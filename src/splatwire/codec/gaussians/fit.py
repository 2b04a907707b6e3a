"""Fits the entropy coder's probability tables to the symbols that were coded in each context."""

import numpy as np

from splatwire.codec.gaussians.layout import (
    NUM_CONTEXTS,
    NUM_DEVIATION_CONTEXTS,
    NUM_MAGNITUDE_CONTEXTS,
    RESIDUAL_KINDS,
    SCALE_INDEX_STEP,
)

_PRIOR_WEIGHT = 4.0
"""Number of residuals at which a context's measured mean has the same weight as the estimate of
`_rank_one_means`."""
_EXPECTED_MAGNITUDES = np.array([
    0.00022850312994217027, 0.0010232186843321654, 0.0024355888262827677, 0.004268452275492507, 0.006624081215933605,
    0.01132872209923163, 0.01677185944509092, 0.023102118543725316, 0.03120918548047908, 0.04737741949105612,
    0.06475169905506163, 0.08272860296118079, 0.10336357514717114, 0.1406592320129188, 0.17839572884387533,
    0.21638215581070802, 0.2593001853708924, 0.3358828414806323, 0.412675512838654, 0.4895891066266564,
    0.5762065598715312, 0.7303326836589681, 0.8845628225899898, 1.0388537427505173, 1.2124743095173134,
    1.5212031755577382, 1.829985539265526, 2.1387965651620635, 2.4862327148937404, 3.103929641378433,
    3.7403648475150675, 4.358107121464482, 5.053079826197598, 6.288597748300994, 7.524123295189053,
    8.759627931620109, 10.193306666885338, 12.664411313402997, 15.135508742740793, 17.606670979576084,
    20.386613333770676, 25.328822626805994, 30.271017485481586, 35.21334195915217, 40.77322666754135,
    50.65764525361199, 60.54062043743582, 70.42668391830433, 81.54388704438108, 101.31132916493014,
    121.08124087487164, 140.85336783660867, 163.08777408876216, 202.6226583298603, 242.16248174974328,
    281.70673567321734, 326.1755481775243, 405.2453166597206, 484.32496349948656, 563.2909901570115,
    652.3510963550486, 810.7442286364997, 969.0121745408575, 1126.581980314023, 1304.7021927100973,
    1621.4884572729993, 1936.575900390324, 2253.163960628046, 2612.034833389368, 3238.9231934028167,
    3878.949932218942, 4514.178666763507, 5224.069666778736, 6477.846386805633, 7757.899864437884,
    8997.008870563379, 10448.139333557472, 12955.692773611267, 15423.443778108649, 17994.017741126758,
])  # fmt: skip
"""Expected magnitude of a residual, in quantisation steps, for each `SCALE_INDEX_STEP`-th entry of the entropy coder's
scale table. It is averaged over predictions uniform within half a step, and increases with the entry. Computing it from
the entries' mixture distributions needs `scipy.special`, and its import takes 0.3 s; a test recomputes the values.
"""


def empty_statistics() -> tuple[np.ndarray, np.ndarray]:
    """Allocates counters for the symbols that the entropy coder codes in each context, initially zero.

    Returns:
        Number of zeros and ones by adaptive bit model, int64 (contexts, 2); and the number and the sum of magnitudes of
        the residuals in each context, int64 (A, B, C, 2). A context of a residual has three indices, see `Coder`.
    """
    return np.zeros((NUM_CONTEXTS, 2), np.int64), np.zeros(
        (len(RESIDUAL_KINDS), NUM_DEVIATION_CONTEXTS, NUM_MAGNITUDE_CONTEXTS, 2), np.int64
    )


def fit_zero_probabilities(counts: np.ndarray) -> np.ndarray:
    """Computes the initial probability that a bit is 0, for each adaptive bit model, from counts of coded bits.

    Args:
        counts: Number of zeros and ones coded with each model, int64 (contexts, 2).

    Returns:
        Probability for each model, int64 (contexts), 1 to 255, out of 2**8.
    """
    probabilities = (counts[:, 0] + 0.5) / (counts.sum(axis=1) + 1.0)
    return np.clip(np.rint(probabilities * 256), 1, 255).astype(np.int64)


def fit_scale_indices(residual_statistics: np.ndarray) -> np.ndarray:
    """Fits the standard deviation of the residual distribution in each context to the mean magnitude of residuals.

    Args:
        residual_statistics: Number of residuals and sum of their magnitudes in each context, int64 (A, B, C, 2) for
            three context indices.

    Returns:
        Index of each context's standard deviation in the coder's table, int64 (A, B, C), a multiple of
        `SCALE_INDEX_STEP`.
    """
    number, total = residual_statistics[..., 0].astype(np.float64), residual_statistics[..., 1].astype(np.float64)
    mean = (total + _PRIOR_WEIGHT * _rank_one_means(number, total)) / (number + _PRIOR_WEIGHT)
    expected = _EXPECTED_MAGNITUDES
    indices = np.searchsorted((expected[1:] + expected[:-1]) / 2, mean)
    # The index of the preceding context takes hardly any bytes in the stream.
    for context in range(NUM_MAGNITUDE_CONTEXTS):
        unused = number[:, :, context] == 0
        indices[:, :, context][unused] = indices[:, :, context - 1][unused] if context else 0
    return indices.astype(np.int64) * SCALE_INDEX_STEP


def _rank_one_means(number: np.ndarray, total: np.ndarray) -> np.ndarray:
    """Estimates the mean magnitude of residuals in each context as a product of two factors.

    A context has three indices (a, b, c). One factor depends on (a, b), the other on (a, c).

    Args:
        number: Number of residuals in each context, float64 (A, B, C).
        total: Sum of their magnitudes, float64 (A, B, C).

    Returns:
        Mean magnitudes, float64 (A, B, C).
    """
    rows, columns = (total.sum(axis=2) + 1.0) / (number.sum(axis=2) + 1.0), np.ones_like(number[:, 0])
    for _ in range(3):
        columns = (total.sum(axis=1) + 1.0) / ((number * rows[:, :, None]).sum(axis=1) + 1.0)
        rows = (total.sum(axis=2) + 1.0) / ((number * columns[:, None]).sum(axis=2) + 1.0)
    return rows[:, :, None] * columns[:, None]


def initial_scale_indices() -> np.ndarray:
    """Returns the same initial standard deviation for all residual contexts, for use before statistics exist.

    Returns:
        Index of the initial standard deviation of each context in the coder's table, int64 (A, B, C). The axes are the
        three indices of a context (see `Coder`).
    """
    return np.full(
        (len(RESIDUAL_KINDS), NUM_DEVIATION_CONTEXTS, NUM_MAGNITUDE_CONTEXTS), 24 * SCALE_INDEX_STEP, dtype=np.int64
    )
