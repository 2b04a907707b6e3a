"""Photos with known cameras, in the common dataset layouts, and camera files.

The names of `__all__` are imported on first use, so that reading a camera file does not import photo readers.
"""

from splatwire.lazy_names import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, __file__)
