"""Calibration of the inpainting network on a single scene: Section 3.4 of the paper (`docs/paper-map.md`)."""
