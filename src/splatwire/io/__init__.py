"""Reading and writing of scenes in any file format; formats are detected by the first bytes of a file."""

from splatwire.lazy_names import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, __file__)
