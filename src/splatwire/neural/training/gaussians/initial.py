"""Initial Gaussians of a training."""

import torch

from splatwire.data import Dataset
from splatwire.neural.training.gaussians.config import GaussianConfig
from splatwire.neural.training.gaussians.state import GaussianState, parameter_shapes
from splatwire.neural.training.initial import (
    camera_extent,
    check_cameras,
    check_visible,
    initial_points,
    mean_squared_distance,
)
from splatwire.ops.spherical_harmonics import DC

_OPACITY, _SIZE = 0.5, 0.5
"""Initial opacity, and initial standard deviation relative to the distance of neighbouring points."""
_SMALLEST, _LARGEST = 1e-5, 0.1
"""Range of the initial standard deviation, relative to the extent of the cameras."""


def initial_gaussians(dataset: Dataset, config: GaussianConfig) -> GaussianState:
    """Creates the state of a training before the first iteration.

    Args:
        dataset: Training views. Its points become Gaussians. If it has more than `config.gaussians` points, a random
            selection is used.
        config: The configuration.

    Raises:
        DatasetError: If the cameras or points are unusable; the message states the reason.
    """
    generator = torch.Generator().manual_seed(config.seed)
    check_cameras(dataset)
    positions, colors = initial_points(dataset, config.gaussians, generator)
    chosen = torch.randperm(len(positions), generator=generator)[: config.gaussians].sort().values
    positions, colors = positions[chosen], None if colors is None else colors[chosen]
    check_visible(dataset, positions.float())
    extent = camera_extent(dataset.cameras)
    sizes = (_SIZE * mean_squared_distance(positions).sqrt()).clamp(_SMALLEST * extent, _LARGEST * extent)
    shapes = parameter_shapes(len(positions), config.degree)
    parameters = {name: torch.zeros(shape) for name, shape in shapes.items()}
    parameters["means"] = positions.float()
    parameters["log_scales"] = sizes.log().float()[:, None].repeat(1, 3)
    parameters["quats"][:, 0] = 1
    parameters["logits"][:] = torch.logit(torch.tensor(_OPACITY))
    if colors is not None:
        parameters["base"] = (colors - 0.5) / DC
    trained = {name: value.requires_grad_() for name, value in parameters.items()}
    cameras = dataset.cameras
    photo_size = cameras.width, cameras.height
    return GaussianState(0, trained, {}, extent, generator, origin=cameras.origin, photo_size=photo_size)
