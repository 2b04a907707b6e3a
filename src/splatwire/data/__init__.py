"""Photos with known cameras, in the common dataset layouts, and camera files."""

from splatwire.lazy_names import lazy_names

# Names are imported on first use, so that reading a camera file does not import photo readers.
__all__, __getattr__, __dir__ = lazy_names(__name__, __file__)
