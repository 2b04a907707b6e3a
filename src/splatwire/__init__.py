"""splatwire: codec and streaming toolkit for 3D Gaussian splats over lossy networks.

Public names are loaded on first use, so that `import splatwire` is fast and a relay, which only needs packets, loads
neither scipy nor numba. Only training, the paper's concealers and importers of checkpoints need torch.
"""

from splatwire.lazy_names import lazy_names
from splatwire.version import __version__ as __version__

_RENAMED = {"ClipOptions": "SequenceOptions", "Partial": "ReceivedScene"}
"""Current name of each deprecated name."""
__all__, __getattr__, __dir__ = lazy_names(__name__, __file__, _RENAMED)
