"""A synthetic scene. Features are a smooth function of position, so neighbours predict lost features."""

import numpy as np
import torch

from concealment.gaps import CONTEXT_DIM, LAYOUT, partial_of
from splatwire.bitstream import PacketMembers
from splatwire.calibration.pseudo_loss import CalibrationData
from splatwire.ops.arrays import to_arrays
from splatwire.types import Anchors, AttributePrior, LossMask, Prior

NUM_PACKETS = 40


def smooth_field(num_anchors: int, *, noise: float, known_to_prior: float, seed: int = 0) -> CalibrationData:
    """Creates the complete scene in packets of scattered anchors.

    Args:
        num_anchors: Anchors, evenly spread over a cube.
        noise: Standard deviation of independent noise; that of the smooth part is 1.
        known_to_prior: Share of the smooth part in the prior's mean. The prior's scale is the spread of the rest.
        seed: Seed of all random choices.
    """
    rng = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=rng)

    places = torch.rand(num_anchors, 3, generator=rng)
    smooth = 2**0.5 * torch.sin(places @ normal(3, LAYOUT.feature_dim) * 3 + 6 * normal(LAYOUT.feature_dim))
    features = smooth + noise * normal(num_anchors, LAYOUT.feature_dim)
    said = known_to_prior * smooth
    offsets, scalings = normal(num_anchors, LAYOUT.num_offsets, 3), torch.full((num_anchors, 6), 0.1)
    ones, step = torch.ones(num_anchors, 1), torch.ones(num_anchors, 1)
    prior = Prior(
        feature=AttributePrior(said, (features - said).std(dim=0) * ones, step),
        scaling=AttributePrior(scalings, 0.01 * ones.expand(-1, 6), step),
        offset=AttributePrior(torch.zeros(num_anchors, 3 * LAYOUT.num_offsets), ones.expand(-1, 12), step),
        context_features=torch.sin(places @ normal(3, CONTEXT_DIM) * 3),
    )
    mask = torch.ones(num_anchors, LAYOUT.num_offsets, dtype=torch.bool)
    anchors = Anchors(positions=places, features=features, scalings=scalings, offsets=offsets, mask=mask)
    loss_mask = LossMask.of_elements(torch.ones(num_anchors, dtype=torch.bool))
    ranks = torch.randperm(num_anchors, generator=rng).numpy()
    starts = np.linspace(0, num_anchors, NUM_PACKETS + 1).astype(np.int64)
    complete = to_arrays(partial_of(anchors, loss_mask, prior, LAYOUT))
    return CalibrationData(complete, PacketMembers(ranks, starts))
