"""Rendering of Gaussians: interfaces of renderers, the compiled CPU renderer, and what is measured by rendering."""

# The names of `__all__` are imported on first use, so that importing the package compiles nothing.

from splatwire.lazy_names import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, __file__)
