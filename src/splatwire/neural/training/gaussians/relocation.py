"""Moving, adding and disturbing Gaussians during training (3DGS-MCMC, arXiv 2404.09591)."""

# A nearly transparent Gaussian is useless, so it is moved to the place of a visible one. The visible one and its copies
# get new opacities and sizes, so that together they look as before. Gaussians are added in the same way, until the
# budget is reached.

import math

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from splatwire.neural.training.gaussians.state import GaussianState
from splatwire.neural.training.kernels import Uniform
from splatwire.ops.quaternions import rotation_rows

MAX_COPIES = 51
"""Maximum number of copies in the formulas of opacity and size. For more copies they use this number, because the sums
become less exact.
"""
_MIN_OPACITY, _MAX_OPACITY = 0.005, 1 - 1e-6
_NOISE_STEEPNESS, _NOISE_OPACITY = 100.0, 0.005
"""Steepness of the logistic function of the opacity that multiplies the position noise, and the opacity at which the
function is 0.5.
"""


def shared_appearance(
    opacities: Float[Tensor, "M"], copies: Int64[Tensor, "M"]
) -> tuple[Float[Tensor, "M"], Float[Tensor, "M"]]:
    """Computes opacity and size of the equal copies that replace a Gaussian and together look like it.

    Source: relocation in 3DGS-MCMC (arXiv 2404.09591).

    Args:
        opacities: Opacity of each replaced Gaussian, in (0, 1).
        copies: Number of copies that replace each Gaussian, 1 to `MAX_COPIES`.

    Returns:
        Opacity of each copy; and standard deviations of a copy relative to those of the replaced Gaussian.
    """
    # Together they have the same opacity at the centre as the given Gaussian, and the same integral of the opacity
    # along a line through the centre (arXiv 2404.09591, section on relocation).
    exact = opacities.double()
    shared = 1 - (1 - exact) ** (1 / copies)
    total, power = torch.zeros_like(exact), torch.ones_like(exact)
    max_copies = int(copies.max()) if len(copies) else 0
    # The double sum of binomials over the copies is a single sum: sum over i of C(i - 1, k) equals C(copies, k + 1).
    for k in range(max_copies):
        power = power * shared
        binomials = torch.tensor([math.comb(n, k + 1) for n in range(max_copies + 1)], dtype=torch.float64).to(
            exact.device
        )
        total += (-1) ** k * binomials[copies] * power / math.sqrt(k + 1)
    return shared.to(opacities), (exact / total).to(opacities)


@torch.no_grad()
def relocate(state: GaussianState, num_gaussians: int, dead_opacity: float) -> None:
    """Moves nearly transparent Gaussians to positions of more opaque ones, and adds new Gaussians at such positions.

    Args:
        state: State of the training; changed in place.
        num_gaussians: Number of Gaussians afterwards, at least the present number.
        dead_opacity: Gaussians with at most this opacity are moved.
    """
    # The targets are drawn at random, with a probability proportional to the opacity. Adam's moments of all moved,
    # added and replaced Gaussians are set to 0.
    opacities = state.opacities.cpu()
    dead = (opacities <= dead_opacity).nonzero()[:, 0]
    alive = (opacities > dead_opacity).nonzero()[:, 0]
    count = state.num_gaussians
    added = num_gaussians - count
    if not len(alive) or not len(dead) + added:
        return
    sampled = torch.multinomial(opacities[alive], len(dead) + added, replacement=True, generator=state.generator)
    sources = alive[sampled]
    num_copies = torch.bincount(sources, minlength=count) + 1
    targets = torch.cat([dead, torch.arange(count, count + added)])
    split = (num_copies > 1).nonzero()[:, 0]
    device = state.device
    for name, values in state.parameters.items():
        rows = torch.cat([values.detach(), values.new_zeros(added, *values.shape[1:])])
        state.parameters[name] = rows
    parameters = state.parameters
    shared, factor = shared_appearance(
        opacities[split].clamp(_MIN_OPACITY, _MAX_OPACITY), num_copies[split].clamp(max=MAX_COPIES)
    )
    parameters["logits"][split.to(device)] = torch.logit(shared.clamp(_MIN_OPACITY, _MAX_OPACITY)).to(device)
    parameters["log_scales"][split.to(device)] += factor.log().to(device)[:, None]
    for name, values in parameters.items():
        values[targets.to(device)] = values[sources.to(device)]
        state.parameters[name] = values.requires_grad_()
    new_rows = torch.cat([targets, split]).to(device)
    for moments in state.moments.values():
        for part in ("first", "second"):
            old = getattr(moments, part)
            rows = torch.cat([old, old.new_zeros(added, *old.shape[1:])])
            rows[new_rows] = 0
            setattr(moments, part, rows)


@torch.no_grad()
def add_noise(state: GaussianState, strength: float, uniform: Uniform) -> None:
    """Moves the centres of nearly transparent Gaussians at random.

    Args:
        state: State of the training; changed in place.
        strength: Strength of the noise, 1 / world unit. A displacement is a random vector times the Gaussian's
            covariance times `strength`.
        uniform: Function that draws uniform random numbers in [0, 1).
    """
    # A displacement is the Gaussian's covariance times a standard normal vector, times `strength`. It falls to 0 for
    # Gaussians of higher opacity.
    parameters = state.parameters
    uniform_numbers = uniform(parameters["means"].shape, state.generator, state.device)
    normal = torch.erfinv((2 * uniform_numbers - 1).clamp(-1 + 1e-6, 1 - 1e-6)) * math.sqrt(2)
    noise_factors = torch.sigmoid(-_NOISE_STEEPNESS * (state.opacities - _NOISE_OPACITY))
    quats = torch.nn.functional.normalize(parameters["quats"], dim=1)
    rotation = torch.stack([torch.stack(row, dim=1) for row in rotation_rows(*quats.unbind(dim=1))], dim=1)
    variances = (2 * parameters["log_scales"]).exp()
    local = (rotation * normal[:, :, None]).sum(dim=1) * variances
    displaced = (rotation * local[:, None, :]).sum(dim=2)
    parameters["means"] += displaced * (strength * noise_factors)[:, None]
