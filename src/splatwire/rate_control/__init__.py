"""Rate control of explicit Gaussians: encodes to a given size or quality by choosing pruning and precision jointly."""

# The names of `__all__` are imported on first use, so that parsing a target size does not import a renderer.

from splatwire.lazy_names import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, __file__)
