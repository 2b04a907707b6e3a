"""Evaluation of streaming with levels of detail: image quality along a camera path at a given network rate."""
