"""Calibration of the inpainting network on a single scene (paper, Section 3.4)."""
