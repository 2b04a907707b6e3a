"""Training of explicit Gaussians from photos, with a fixed budget of Gaussians (3DGS-MCMC, arXiv 2404.09591)."""

from splatwire.neural.training.gaussians.checkpoint import load_gaussian_checkpoint, save_gaussian_checkpoint
from splatwire.neural.training.gaussians.config import GaussianConfig
from splatwire.neural.training.gaussians.trainer import GaussianResult, train_gaussians

__all__ = [
    "GaussianConfig",
    "GaussianResult",
    "load_gaussian_checkpoint",
    "save_gaussian_checkpoint",
    "train_gaussians",
]
