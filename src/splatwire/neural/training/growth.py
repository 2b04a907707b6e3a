"""Adding (growing) and removing (pruning) anchors during training, with the rules of HAC++ and Scaffold-GS."""

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from splatwire.anchors.projection import DILATION
from splatwire.errors import DivergedError
from splatwire.neural.training.config import TrainConfig
from splatwire.neural.training.kernels import Uniform, uniform_from_host
from splatwire.neural.training.state import MAX_TRAINED_INDEX, TrainState, append_anchors, keep_anchors
from splatwire.types import Cameras, Gaussians

_KEY_BITS = 21
"""Number of bits of a signed voxel index; three indices fit one 64-bit key."""
_MAX_TRANSPARENT_SHARE = 0.99
"""Share of transparent anchors among the examined ones above which no anchor is removed.

With a black background, most random initial points become transparent before the scene takes shape. If transparent
anchors were then removed, arbitrary anchors would remain (lego, 3,120 iterations: no anchors)."""


@torch.no_grad()
def gather_statistics(
    state: TrainState,
    visible: Int64[Tensor, "M"],
    drawn: tuple[Gaussians, Int64[Tensor, "G"], Int64[Tensor, "G"]],
    d_centers: Float[Tensor, "G 2"],
    cameras: Cameras,
    view: int,
) -> None:
    """Updates the statistics for adding and removing anchors with the opacities and gradients of one view.

    Args:
        state: State of the training; the statistics are changed in place.
        visible: Indices of the anchors that the view may see.
        drawn: The drawn Gaussians, their anchor indices (among all anchors) and their offset indices.
        d_centers: Gradient of the loss with respect to the Gaussians' 2D centres, per pixel.
        cameras: The cameras.
        view: Index of the camera.
    """
    gaussians, anchor_index, offset_index = drawn
    statistics = state.statistics
    num_offsets = statistics.gradient_sum.shape[1]
    statistics.visits[visible] += 1
    statistics.opacity_sum.index_add_(0, anchor_index, gaussians.opacities)
    half_size = d_centers.new_tensor([cameras.width / 2, cameras.height / 2])
    in_image = on_image(gaussians, cameras, view)
    rows = (anchor_index * num_offsets + offset_index)[in_image]  # each one occurs once
    statistics.gradient_sum.view(-1)[rows] += torch.linalg.vector_norm(d_centers * half_size, dim=1)[in_image]
    statistics.gradient_count.view(-1)[rows] += 1


def on_image(gaussians: Gaussians, cameras: Cameras, view: int) -> Bool[Tensor, "G"]:
    """Returns the mask of the Gaussians that may intersect the image, bool (G)."""
    # Tests a bounding sphere of three standard deviations along the longest axis.
    pose, K = (torch.as_tensor(values[view]).to(gaussians.means) for values in (cameras.viewmats, cameras.Ks))
    local = gaussians.means @ pose[:3, :3].T + pose[:3, 3]
    z = local[:, 2].clamp(min=cameras.near_depth)
    x, y = K[0, 0] * local[:, 0] / z + K[0, 2], K[1, 1] * local[:, 1] / z + K[1, 2]
    radius = 3 * torch.sqrt((gaussians.scales.amax(dim=1) * torch.maximum(K[0, 0], K[1, 1]) / z).square() + DILATION)
    inside = (x > -radius) & (x < cameras.width + radius) & (y > -radius) & (y < cameras.height + radius)
    return inside & (local[:, 2] > cameras.near_depth)


@torch.no_grad()
def adjust_anchors(state: TrainState, config: TrainConfig, uniform: Uniform = uniform_from_host) -> tuple[int, int]:
    """Adds anchors near Gaussians that need detail, and removes transparent anchors (as in Scaffold-GS).

    A Gaussian needs detail if the gradient of the loss with respect to its 2D centre is large.

    Args:
        state: State of the training; changed in place.
        config: The configuration.
        uniform: Function that draws uniform random numbers in [0, 1).

    Returns:
        The numbers of added and of removed anchors.

    Raises:
        DivergedError: If nearly all examined anchors are transparent although half of the iterations until
            `Milestones.growth_end` have passed: such a scene cannot recover. Checked only when anchors may be removed.
    """
    statistics, rules = state.statistics, config.growth
    min_views = config.milestones.growth_interval * rules.min_views_factor
    judged = statistics.gradient_count > min_views * 0.5
    gradients = statistics.gradient_sum / statistics.gradient_count.clamp(min=1)
    num_before = state.num_anchors
    _grow(state, config, torch.where(judged, gradients, -1.0), uniform)
    statistics = state.statistics
    earlier_anchors = slice(0, num_before)
    statistics.gradient_sum[earlier_anchors][judged] = 0
    statistics.gradient_count[earlier_anchors][judged] = 0
    visited = statistics.visits > min_views
    transparent = visited & (statistics.opacity_sum < rules.min_opacity * statistics.visits)
    mostly_transparent = int(transparent.sum()) > _MAX_TRANSPARENT_SHARE * int(visited.sum())
    # Before `first_pruning`, however short the training, transparent anchors may still take shape.
    is_early = state.iteration < rules.first_pruning
    if mostly_transparent and not is_early and 2 * state.iteration > config.milestones.growth_end:
        raise DivergedError(state.iteration, "every anchor has become transparent")
    keep = ~transparent
    if mostly_transparent or is_early:
        keep[:] = True
    statistics.opacity_sum[visited] = 0
    statistics.visits[visited] = 0
    num_added = state.num_anchors - num_before
    keep_anchors(state, keep)
    state.parameters["log_scalings"][:, -3:].clamp_(max=rules.max_log_size)
    return num_added, int((~keep).sum())


def _grow(state: TrainState, config: TrainConfig, gradients: Float[Tensor, "N K"], uniform: Uniform) -> None:
    """Adds anchors near Gaussians with large gradients, on grids of several cell sizes, the coarsest grid first.

    On grid i, a Gaussian with a large gradient is used with the probability `1 - 0.5 ** (i + 1)` (Scaffold-GS).

    Args:
        state: State of the training; changed in place.
        config: The configuration.
        gradients: Mean length of the gradient of the loss with respect to the 2D centre of each offset's Gaussian.
            Negative for offsets drawn in too few views.
        uniform: Draws the random numbers for this choice.
    """
    rules, num_before = config.growth, state.num_anchors
    for level in range(rules.levels):
        cell = rules.coarsest_cell // rules.cell_ratio**level
        if cell < 1 or (level > 0 and state.num_anchors == num_before):
            break
        chosen = gradients >= rules.gradient_threshold * 2**level
        uniform_noise = uniform(gradients.shape, state.generator, gradients.device)
        chosen &= uniform_noise > 0.5 ** (level + 1)
        _add_level(state, config, chosen, cell)


def _add_level(state: TrainState, config: TrainConfig, chosen: Bool[Tensor, "M K"], cell: int) -> None:
    """Adds an anchor to each empty grid cell in which a chosen Gaussian has its centre.

    A cell is empty if it contains no anchor. At most `GrowthRules.max_anchors` anchors exist afterwards.

    Args:
        state: State of the training; changed in place.
        config: The configuration.
        chosen: Mask of the chosen Gaussians, by anchor and offset.
        cell: Size of the grid's cells in voxels.
    """
    anchor_index, offset_index = chosen.nonzero().unbind(dim=1)
    parameters = state.parameters
    offset_scales = state.scalings(anchor_index)[:, :3]
    centers = state.positions[anchor_index] + parameters["offsets"][anchor_index, offset_index] * offset_scales
    cells = torch.round(centers.double() / (state.voxel_size * cell))
    possible = torch.isfinite(cells).all(dim=1) & (cells.abs() * cell <= MAX_TRAINED_INDEX).all(dim=1)
    cells, anchor_index = cells[possible].to(torch.int64), anchor_index[possible]
    occupied = torch.round(state.voxels.double() / cell).to(torch.int64)
    keys, source = torch.unique(_keys(cells), return_inverse=True)
    free = ~torch.isin(keys, _keys(occupied))
    free &= free.cumsum(dim=0) <= config.growth.max_anchors - state.num_anchors
    features = _maximum_by_group(parameters["features"][anchor_index], source, len(keys))[free]
    count = int(free.sum())
    if not count:
        return
    size = torch.log(torch.tensor(state.voxel_size * cell, dtype=torch.float64))
    new = {
        "features": features,
        "log_scalings": size.float().to(features.device).expand(count, parameters["log_scalings"].shape[1]),
        "offsets": features.new_zeros(count, config.model.layout.num_offsets, 3),
        "mask_logits": features.new_ones(count, config.model.layout.num_offsets),
    }
    append_anchors(state, _cells(keys[free]) * cell, new)


def _keys(cells: Int64[Tensor, "M 3"]) -> Int64[Tensor, "M"]:
    """Combines the three indices of each grid cell in one 64-bit integer."""
    shifted = cells + (1 << (_KEY_BITS - 1))
    return (shifted[:, 0] << (2 * _KEY_BITS)) | (shifted[:, 1] << _KEY_BITS) | shifted[:, 2]


def _cells(keys: Int64[Tensor, "M"]) -> Int64[Tensor, "M 3"]:
    """Splits 64-bit cell numbers into the three indices of each grid cell."""
    low = (1 << _KEY_BITS) - 1
    parts = [keys >> (2 * _KEY_BITS), (keys >> _KEY_BITS) & low, keys & low]
    return torch.stack(parts, dim=1) - (1 << (_KEY_BITS - 1))


def _maximum_by_group(rows: Float[Tensor, "M F"], group: Int64[Tensor, "M"], num_groups: int) -> Float[Tensor, "U F"]:
    """Divides the rows of a matrix into groups, and returns the maximum of each column in each group.

    Args:
        rows: The matrix.
        group: Index of the group of each row, 0 to U - 1.
        num_groups: Number of groups, U.
    """
    index = group[:, None].expand(-1, rows.shape[1])
    return rows.new_full((num_groups, rows.shape[1]), -torch.inf).scatter_reduce_(0, index, rows, "amax")
