"""Evaluation of sequences: image quality per frame under losses, and its report."""
