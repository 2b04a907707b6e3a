"""Bitstream format of moving Gaussians: keyframe Gaussians and their motion (docs/motion.md)."""
