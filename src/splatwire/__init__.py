"""splatwire: 3D Gaussian splats across lossy networks."""

__version__ = "0.1.0"
