"""Gaussians in levels: coarser ones stand for many finer ones."""
