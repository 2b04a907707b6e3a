"""splatwire: codec and streaming toolkit for 3D Gaussian splats over lossy networks.

Public names are imported on first use. Only training, some concealers and importers of checkpoints need torch.
"""

from splatwire.lazy_names import lazy_names
from splatwire.version import __version__ as __version__

_RENAMED = {"ClipOptions": "SequenceOptions", "Partial": "ReceivedScene"}
"""Current name of each deprecated name."""
__all__, __getattr__, __dir__ = lazy_names(__name__, __file__, _RENAMED)
