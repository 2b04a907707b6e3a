"""Decoding in a fresh process: proof that the bytes of a stream are all that a decoder needs."""

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from splatwire.errors import DesyncError, SplatwireError

if TYPE_CHECKING:
    from splatwire.model import PartialScene
    from splatwire.packets import SceneStream


def decode_in_fresh_process(stream: "SceneStream") -> "PartialScene":
    """Writes a stream to a file, has a new interpreter decode it, and reads the scene back.

    Args:
        stream: What arrived.

    Raises:
        SplatwireError: If the other process failed; the message is its own.
        DesyncError: If the scene read back is not the one whose digest the other process printed.
    """
    from splatwire.model.scene_digest import scene_digest
    from splatwire.model.scene_file import load_partial
    from splatwire.packets import write_stream

    with tempfile.TemporaryDirectory(prefix="splatwire-") as name:
        sent, decoded = Path(name) / "received.swz", Path(name) / "decoded.scene"
        write_stream(stream, sent)
        command = [sys.executable, "-m", "splatwire", "decode", str(sent), "-o", str(decoded), "--json"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise SplatwireError(f"decoding in a fresh process failed: {' '.join(done.stderr.split())[-500:]}")
        partial = load_partial(decoded)
    if scene_digest(partial.scene.anchors) != json.loads(done.stdout)["digest"]:
        raise DesyncError("the scene that a fresh process decoded is not the one that was read back")
    return partial
