"""Calibration of the inpainting network on its own scene (paper, Section 3.4)."""
