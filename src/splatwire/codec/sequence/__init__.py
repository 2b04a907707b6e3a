"""Bitstream format of moving Gaussians: keyframe Gaussians that persist over frames, and their motion (docs/motion.md).

Motion is coded for one group of frames (similar to a group of pictures in video) after another.
"""
