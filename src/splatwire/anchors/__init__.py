"""Anchor scenes (neural Gaussians as in HAC++) without torch: files, Gaussians of a view, projection."""
