"""Gaussians that move: bases that last, and their motion in groups of frames (docs/motion.md)."""
