"""Gaussians with levels of detail: a coarser Gaussian replaces several finer ones."""
