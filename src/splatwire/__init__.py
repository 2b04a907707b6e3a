"""splatwire: 3D Gaussian splats across lossy networks.

The names of `__all__` are loaded on first use, so that `import splatwire` costs nothing and a relay that only needs
packets loads neither scipy nor numba. Only training, the paper's concealers and neural importers need torch.
"""

import importlib
from typing import TYPE_CHECKING, Any

from splatwire.errors import how_to_install
from splatwire.version import __version__ as __version__

if TYPE_CHECKING:
    from splatwire.channel import parse_loss as parse_loss
    from splatwire.channel import transmit as transmit
    from splatwire.codec import decode_stream as decode_stream
    from splatwire.codec import encode_scene as encode_scene
    from splatwire.conceal import create_concealer as create_concealer
    from splatwire.errors import SplatwireError as SplatwireError
    from splatwire.importers.hacpp import import_hacpp as import_hacpp
    from splatwire.model.anchor_scene import AnchorScene as AnchorScene
    from splatwire.model.partial import Partial as Partial
    from splatwire.packets import Packetization as Packetization
    from splatwire.packets import SceneStream as SceneStream
    from splatwire.packets import read_stream as read_stream
    from splatwire.packets import write_stream as write_stream
    from splatwire.render import render_scene as render_scene
    from splatwire.scene_io import open_scene as open_scene
    from splatwire.scene_io import save_scene as save_scene

_HOME = {
    "AnchorScene": "splatwire.model.anchor_scene",
    "Packetization": "splatwire.packets",
    "Partial": "splatwire.model.partial",
    "SceneStream": "splatwire.packets",
    "SplatwireError": "splatwire.errors",
    "create_concealer": "splatwire.conceal",
    "decode_stream": "splatwire.codec",
    "encode_scene": "splatwire.codec",
    "import_hacpp": "splatwire.importers.hacpp",
    "open_scene": "splatwire.scene_io",
    "parse_loss": "splatwire.channel",
    "read_stream": "splatwire.packets",
    "render_scene": "splatwire.render",
    "save_scene": "splatwire.scene_io",
    "transmit": "splatwire.channel",
    "write_stream": "splatwire.packets",
}

__all__ = [*_HOME, "__version__"]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'splatwire' has no attribute '{name}'")
    try:
        value = getattr(importlib.import_module(_HOME[name]), name)
    except ModuleNotFoundError as error:
        if how := how_to_install(error.name):
            error.add_note(how)
        raise
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
