"""Initial state of a training: anchors at the dataset's sparse points, random network weights."""

import math
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int64
from scipy.spatial import cKDTree
from torch import Tensor

from splatwire.anchors.appearance import explicit_gaussians, origin_of
from splatwire.anchors.voxels import voxel_positions
from splatwire.data import Dataset, SparsePoints
from splatwire.errors import DatasetError, InvalidValueError
from splatwire.neural.training.config import TrainConfig
from splatwire.neural.training.grid import INITIAL_VALUE
from splatwire.neural.training.state import (
    ANCHOR_PARAMETERS,
    GRID_PARAMETERS,
    MAX_TRAINED_INDEX,
    GrowthStatistics,
    TrainState,
)
from splatwire.ops.arrays import to_numpy
from splatwire.ops.spherical_harmonics import DC
from splatwire.types import Cameras
from splatwire.types.causal_coding import NUM_LOG_SCALINGS, CausalConfig
from splatwire.types.scene import Scene

INITIAL_STEPS = (0.5, 0.05, 0.1, 0.2)
"""Initial quantisation steps of the causal model: features, logarithms of the offset scale, logarithms of base
sizes, offsets.
"""
_BOX_SHARE = 1.3 / 4.03
"""Half side of the box of random initial points, divided by the distance of the cameras from the scene.

NeRF-synthetic uses the box [-1.3, 1.3] for cameras at distance 4.03.
"""
_PIXELS_PER_POINT = 4
"""Minimum number of pixels of a view per random initial point.

More points do not improve scenes with small views (tested with 100,000 points and views of 200x200 pixels).
"""
_MIN_POINTS = 500
_MIN_SQUARED_DISTANCE = 1e-7
_BOUNDS_MARGIN = 0.2


def initial_state(dataset: Dataset, config: TrainConfig) -> TrainState:
    """Creates the state of a training before the first iteration.

    Anchors are relative to the origin of the dataset's cameras.

    Args:
        dataset: Training views. The points of the dataset become anchors; without points, anchors are random.
        config: The configuration.

    Raises:
        DatasetError: If the cameras or points are unusable; the message states the reason.
    """
    generator = torch.Generator().manual_seed(config.seed)
    check_cameras(dataset)
    points, _ = initial_points(dataset, config.random_points, generator)
    voxel_size = config.voxel_size or _derived_voxel_size(points)
    voxels = _voxels(points, voxel_size)
    positions = torch.from_numpy(voxel_positions(voxels, voxel_size))
    check_visible(dataset, positions)
    parameters = {**anchor_parameters(voxels, voxel_size, config), **_networks(config, generator)}
    causal = isinstance(config.model, CausalConfig)
    bounds_min, bounds_max = position_bounds(voxels) if causal else grid_bounds(positions)
    return TrainState(
        iteration=0,
        voxels=voxels,
        voxel_size=voxel_size,
        parameters={name: value.requires_grad_() for name, value in parameters.items()},
        moments={},
        statistics=GrowthStatistics.zeros(len(voxels), config.model.layout.num_offsets, torch.device("cpu")),
        bounds_min=bounds_min,
        bounds_max=bounds_max,
        camera_extent=camera_extent(dataset.cameras),
        generator=generator,
        origin=dataset.cameras.origin,
        photo_size=(dataset.cameras.width, dataset.cameras.height),
    )


def points_of(scene: Scene) -> SparsePoints:
    """Converts explicit Gaussians to initial points of a training: their centres and colours.

    Gaussians with an opacity of at most 1/255 are omitted.

    Raises:
        InvalidValueError: If no Gaussian is left, or the scene has no explicit Gaussians.
    """
    # Gaussians with an opacity of 1/255 or less are skipped as invisible.
    splats = explicit_gaussians(scene)
    if splats is None:
        raise InvalidValueError(f"a scene of {scene.ELEMENTS} has no Gaussians to start from")
    shown = splats.select(splats.opacities > 1 / 255)
    if not shown.num_gaussians:
        raise InvalidValueError("all Gaussians to start from are transparent")
    return SparsePoints(shown.means, np.clip(0.5 + DC * shown.sh[:, 0], 0, 1), origin_of(scene))


def camera_extent(cameras: Cameras) -> float:
    """Returns 1.1 times the largest distance of a camera from the mean camera centre, world units (as in HAC++)."""
    centers = to_numpy(cameras.centers).astype(np.float64)
    return 1.1 * float(np.linalg.norm(centers - centers.mean(axis=0), axis=1).max())


def grid_bounds(positions: Float[Tensor, "N 3"]) -> tuple[Float[Tensor, "3"], Float[Tensor, "3"]]:
    """Returns the bounding box of the hash grid, which is larger than the bounding box of the anchors (HAC++)."""
    # Each face is moved outwards by 20 % of the absolute value of its coordinate. Along an axis where all anchors
    # have the same coordinate, the box extends by 0.5 on both sides, so that it is never flat.
    low, high = positions.amin(dim=0), positions.amax(dim=0)
    low, high = low - _BOUNDS_MARGIN * low.abs(), high + _BOUNDS_MARGIN * high.abs()
    flat = high - low < 1e-6
    return torch.where(flat, low - 0.5, low), torch.where(flat, high + 0.5, high)


def position_bounds(voxels: Int64[Tensor, "N 3"]) -> tuple[Float[Tensor, "3"], Float[Tensor, "3"]]:
    """Returns the range of positions, in voxels, that the causal model uses to normalise its inputs.

    The range is the median position minus and plus twice the median absolute deviation, which is
    rounded up and counts as at least 1.
    """
    middle = voxels.median(dim=0).values.float()
    spread = (voxels - middle).abs().median(dim=0).values.clamp(min=1).ceil() * 2
    return middle - spread, middle + spread


def anchor_parameters(voxels: Int64[Tensor, "N 3"], voxel_size: float, config: TrainConfig) -> dict[str, Tensor]:
    """Returns the initial parameters of anchors.

    Args:
        voxels: Positions of the anchors in voxels.
        voxel_size: World units per voxel.
        config: The configuration.
    """
    # Sizes are set to the distance to the nearest anchors; all other parameters are constants.
    layout = config.model.layout
    squared = mean_squared_distance(torch.from_numpy(voxel_positions(voxels, voxel_size))).clamp(
        min=_MIN_SQUARED_DISTANCE
    )
    return {
        "features": torch.zeros(len(voxels), layout.feature_dim),
        "log_scalings": (0.5 * squared.log()).float()[:, None].repeat(1, log_scalings_dim(config)),
        "offsets": torch.zeros(len(voxels), layout.num_offsets, 3),
        "mask_logits": torch.ones(len(voxels), layout.num_offsets),
    }


def _folder(dataset: Dataset) -> Path:
    """Returns the folder with the photos of a dataset."""
    return dataset.image_paths[0].parent if dataset.image_paths else Path()


def check_cameras(dataset: Dataset) -> None:
    """Checks that a scene can be trained from the cameras of a dataset.

    Raises:
        DatasetError: If there are fewer than two views, a camera is not finite, or all cameras are at one position.
    """
    cameras, folder = dataset.cameras, _folder(dataset)
    if cameras.num_views < 2:
        raise DatasetError(f"{folder}: training needs at least 2 views, and there is {cameras.num_views}")
    if not (np.isfinite(cameras.viewmats).all() and np.isfinite(cameras.Ks).all()):
        raise DatasetError(f"{folder}: a camera's pose or intrinsics are not finite")
    if camera_extent(cameras) < 1e-9:
        raise DatasetError(f"{folder}: all cameras stand at the same place: depth cannot be learnt from them")


def initial_points(
    dataset: Dataset, random_points: int, generator: torch.Generator
) -> tuple[Float[Tensor, "P 3"], Float[Tensor, "P 3"] | None]:
    """Returns the P points from which a training starts: points of the dataset, or random points if it has none.

    Args:
        dataset: Training views, and the points of a reconstruction if the dataset has one.
        random_points: Maximum number of random points.
        generator: Random generator for random points, on the CPU.

    Returns:
        Positions of the points relative to `dataset.cameras.origin`, float64; and their colours, RGB in [0, 1], or None
        for random points.

    Raises:
        DatasetError: If the dataset has points, but fewer than four of them have finite positions.
    """
    if dataset.points is not None and dataset.points.num_points:
        sparse = dataset.points.relative_to(dataset.cameras.origin)
        points, colors = torch.as_tensor(sparse.positions).double(), torch.as_tensor(sparse.colors)
        finite = torch.isfinite(points).all(dim=1)
        points = points[finite]
        if len(points) < 4:
            raise DatasetError(
                f"{_folder(dataset)}: the reconstruction has {len(points)} usable points; at least 4 are needed"
            )
        return points, colors[finite].float()
    center, distance = _view_center(dataset.cameras)
    pixels = dataset.cameras.width * dataset.cameras.height
    count = min(random_points, max(pixels // _PIXELS_PER_POINT, _MIN_POINTS))
    unit = torch.rand(count, 3, generator=generator, dtype=torch.float64)
    return center + (2 * unit - 1) * distance * _BOX_SHARE, None


def _view_center(cameras: Cameras) -> tuple[Float[Tensor, "3"], float]:
    """Returns the point closest to the optical axes of all cameras, and the median distance of the cameras from it."""
    axes, centers = torch.as_tensor(cameras.viewmats)[:, 2, :3].double(), torch.as_tensor(cameras.centers).double()
    projections = torch.eye(3, dtype=torch.float64) - axes[:, :, None] * axes[:, None, :]
    # a small weight on the mean camera centre keeps the solution finite if all axes are parallel
    matrix = projections.sum(dim=0) + 1e-6 * len(axes) * torch.eye(3, dtype=torch.float64)
    target = (projections @ centers[:, :, None]).sum(dim=0)[:, 0] + 1e-6 * len(axes) * centers.mean(dim=0)
    center = torch.linalg.solve(matrix, target)
    return center, float(torch.linalg.vector_norm(centers - center, dim=1).median())


def _voxels(points: Float[Tensor, "P 3"], voxel_size: float) -> Int64[Tensor, "N 3"]:
    index = torch.round(points / voxel_size)
    index = index[(index.abs() <= MAX_TRAINED_INDEX).all(dim=1)].to(torch.int64)
    if not len(index):
        raise DatasetError(
            f"all points are more than {MAX_TRAINED_INDEX} voxels of {voxel_size} away: choose a larger voxel size"
        )
    return torch.unique(index, dim=0)


def _derived_voxel_size(points: Float[Tensor, "P 3"]) -> float:
    """Derives a voxel size from the spacing of points."""
    # The median of the mean squared distance to three neighbours; as in HAC++, it is used as a length, without a
    # square root.
    size = float(mean_squared_distance(torch.unique(points, dim=0)).median())
    if not (math.isfinite(size) and size > 0):
        raise DatasetError("the points give no voxel size: name one")
    return size


def mean_squared_distance(positions: Float[Tensor, "N 3"]) -> Float[Tensor, "N"]:
    """Returns the mean squared distance of each position to the three nearest other positions."""
    # 0.01 for a single position.
    points = positions.double().numpy()
    neighbours = min(3, len(points) - 1)
    if neighbours < 1:
        return torch.full((len(points),), 1e-2, dtype=torch.float64)
    distances, _ = cKDTree(points).query(points, k=np.arange(2, neighbours + 2), workers=-1)
    return torch.from_numpy(np.square(distances).mean(axis=1))


def check_visible(dataset: Dataset, positions: Float[Tensor, "N 3"], elements: str = "points") -> None:
    """Checks that at least half of the cameras see an anchor.

    Args:
        dataset: The training views.
        positions: Positions of the anchors, relative to the origin of the cameras.
        elements: Plural noun for the elements at these positions, for the message.

    Raises:
        DatasetError: If more than half of the cameras see no anchor.
    """
    cameras, blind_cameras = dataset.cameras, []
    homogeneous = torch.cat([positions, torch.ones(len(positions), 1)], dim=1)
    for view in range(cameras.num_views):
        local = homogeneous @ torch.as_tensor(cameras.viewmats[view, :3]).T.to(positions)
        pixels = local @ torch.as_tensor(cameras.Ks[view]).T.to(positions)
        x, y = pixels[:, 0] / local[:, 2], pixels[:, 1] / local[:, 2]
        inside = (local[:, 2] > cameras.near_depth) & (x > 0) & (x < cameras.width) & (y > 0) & (y < cameras.height)
        if not bool(inside.any()):
            blind_cameras.append(cameras.names[view])
    if 2 * len(blind_cameras) > cameras.num_views:
        raise DatasetError(
            f"{_folder(dataset)}: {len(blind_cameras)} of {cameras.num_views} training views see none of the "
            f"{elements}, the first is '{blind_cameras[0]}': poses and {elements} do not belong together, or the "
            "cameras look away"
        )


def parameter_shapes(config: TrainConfig, num_anchors: int) -> dict[str, tuple[int, ...]]:
    """Returns the shape of every tensor in `TrainState.parameters` with `num_anchors` anchors, by name."""
    layout, model = config.model.layout, config.model
    shapes: dict[str, tuple[int, ...]] = {
        "features": (num_anchors, layout.feature_dim),
        "log_scalings": (num_anchors, log_scalings_dim(config)),
        "offsets": (num_anchors, layout.num_offsets, 3),
        "mask_logits": (num_anchors, layout.num_offsets),
    }
    for prefix, (first, hidden, last) in _network_widths(config).items():
        for layer, fan_in, fan_out in (("hidden", first, hidden), ("output", hidden, last)):
            shapes[f"{prefix}.{layer}.weight"] = (fan_out, fan_in)
            shapes[f"{prefix}.{layer}.bias"] = (fan_out,)
    if isinstance(model, CausalConfig):
        return {**shapes, "log_steps": (model.num_steps,), "zero_points": (NUM_LOG_SCALINGS,)}
    depth = model.grid.features_per_level
    shapes["grid.volume"] = (sum(model.grid.rows(3)), depth)
    shapes["grid.planes"] = (3, sum(model.grid.rows(2)), depth)
    return shapes


def log_scalings_dim(config: TrainConfig) -> int:
    """Returns the number of scalings per anchor: 6 with the HAC++ model, 4 with the causal model."""
    # The causal model has one scale for all offset axes, and three sizes of Gaussians.
    return NUM_LOG_SCALINGS if isinstance(config.model, CausalConfig) else 6


def _network_widths(config: TrainConfig) -> dict[str, tuple[int, int, int]]:
    """Returns the layer widths (inputs, hidden units, outputs) of every network, by name."""
    layout = config.model.layout
    head, prior, channel = config.hidden
    inputs, num_offsets = layout.feature_dim + 4, layout.num_offsets
    widths = {
        "heads.opacity": (inputs, head, num_offsets),
        "heads.covariance": (inputs, head, 7 * num_offsets),
        "heads.color": (inputs, head, 3 * num_offsets),
    }
    if isinstance(config.model, CausalConfig):
        return widths | {f"causal.{n}": (i, channel, o) for n, (i, o) in config.model.shapes().items()}
    widths["prior"] = (config.model.grid.context_dim, prior, config.model.prior_dim)
    before = 0
    for group, size in enumerate(layout.feature_groups):
        widths[f"channel.{group}"] = (before + 3 * layout.feature_dim, channel, 3 * size)
        before += size
    return widths


def _networks(config: TrainConfig, generator: torch.Generator) -> dict[str, Tensor]:
    """Returns random initial values of all networks and of the hash grid, by name."""
    # Weights and biases are uniform within 1 / sqrt(number of inputs of the layer).
    parameters = {}
    fan_in = 1
    for name, shape in parameter_shapes(config, 0).items():
        if name in ANCHOR_PARAMETERS:
            continue
        if name in GRID_PARAMETERS:
            parameters[name] = _uniform(shape, INITIAL_VALUE, generator)
            continue
        if name in ("log_steps", "zero_points"):
            parameters[name] = initial_log_steps(config) if name == "log_steps" else torch.zeros(shape)
            continue
        fan_in = shape[1] if name.endswith("weight") else fan_in  # a bias follows the weight of its layer
        parameters[name] = _uniform(shape, fan_in**-0.5, generator)
    return parameters


def initial_log_steps(config: TrainConfig) -> Float[Tensor, "S"]:
    """Returns the natural logarithms of the causal model's initial quantisation steps."""
    feature, *rest = INITIAL_STEPS
    return torch.tensor([feature] * len(config.model.layout.feature_groups) + rest).log()


def _uniform(shape: tuple[int, ...], bound: float, generator: torch.Generator) -> Tensor:
    return (2 * torch.rand(shape, generator=generator) - 1) * bound
