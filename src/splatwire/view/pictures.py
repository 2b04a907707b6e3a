"""Pictures that a page asks for of what browsers do not draw: a query in, a JPEG and figures out."""

import io
import json
import math
import threading
from typing import Any
from urllib.parse import parse_qsl

import torch
from PIL import Image
from scipy.spatial.transform import Rotation

from splatwire.errors import InvalidValueError
from splatwire.scene import Cameras
from splatwire.view.model import Settings, Status, Viewer

MOST_PIXELS = 2560 * 1600
"""Of one picture; with one at a time, what bounds the memory that pages can ask for."""
_NUMBERS = {
    "x": (-1e9, 1e9), "y": (-1e9, 1e9), "z": (-1e9, 1e9), "a": (-1, 1), "b": (-1, 1), "c": (-1, 1), "d": (-1, 1),
    "fov": (0.05, 3), "width": (1, 8192), "height": (1, 8192), "drop": (0, 0.95), "burst": (1, 50), "seed": (0, 2**31),
    "sent": (0, 1), "score": (0, 1),
}  # fmt: skip
"""What a query says in numbers: place, turn (a quaternion, camera to world, OpenCV axes), lens, size, losses."""


class Pictures:
    """Draws one picture at a time, for whoever asks, in any thread.

    Args:
        viewer: What draws.
    """

    def __init__(self, viewer: Viewer) -> None:
        self._viewer = viewer
        self._one = threading.Lock()

    def answer(self, query: str) -> tuple[bytes, str]:
        """Draws what a page asks for.

        Args:
            query: All of `_NUMBERS`, `concealer`, and `show`, one of `model.LAYERS`.

        Returns:
            A JPEG; and what is known about it, a JSON object in ASCII.

        Raises:
            InvalidValueError: If something is missing, no number or out of range.
            UnknownNameError: If there is no such concealer.
        """
        fields = _fields(query)
        settings = Settings(
            fields["drop"], fields["burst"], int(fields["seed"]), fields["concealer"], fields["sent"], fields["show"]
        )
        sharp = fields["score"] > 0
        with self._one:
            self._viewer.source.advance()
            frame = self._viewer.frame(settings, _camera(fields), score=sharp)
        file = io.BytesIO()
        Image.fromarray(frame.image.numpy()).save(file, "jpeg", quality=90 if sharp else 75)
        return file.getvalue(), json.dumps(_told(frame.status, self._viewer))


def _fields(query: str) -> dict[str, Any]:
    try:
        texts = dict(parse_qsl(query, max_num_fields=len(_NUMBERS) + 2))
        fields: dict[str, Any] = {name: float(texts[name]) for name in _NUMBERS}
        fields |= {name: texts[name] for name in ("concealer", "show")}
    except (KeyError, ValueError) as error:
        raise InvalidValueError(f"a picture is asked for with its numbers: {error}") from error
    for name, (low, high) in _NUMBERS.items():
        if not low <= fields[name] <= high:
            raise InvalidValueError(f"'{name}' of a picture must be from {low:g} to {high:g}, not {fields[name]:g}")
    if fields["width"] * fields["height"] > MOST_PIXELS:
        raise InvalidValueError(f"a picture has at most {MOST_PIXELS:,} pixels")
    if math.hypot(*(fields[name] for name in "abcd")) < 0.5:
        raise InvalidValueError("'a b c d' of a picture is no rotation")
    return fields


def _camera(fields: dict[str, Any]) -> Cameras:
    """One pinhole camera."""
    width, height = int(fields["width"]), int(fields["height"])
    turn = torch.from_numpy(Rotation.from_quat([fields[name] for name in "bcda"]).as_matrix())
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = turn.T
    pose[:3, 3] = -turn.T @ torch.tensor([fields[name] for name in "xyz"], dtype=torch.float64)
    focal = height / 2 / math.tan(fields["fov"] / 2)
    lens = torch.tensor([[[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]])
    return Cameras(pose[None].float(), lens, width, height, ("view",))


def _told(status: Status, viewer: Viewer) -> dict[str, Any]:
    """Figures of a picture; `psnr` is null where it was not asked for and text where nothing differs."""
    quality = "no loss" if status.psnr == math.inf else status.psnr
    return {
        "bytes": status.bytes_sent, "packets": status.packets_received, "expected": status.packets_total,
        "known": status.known, "total": status.total, "seconds": status.seconds, "psnr": quality, "ms": status.draw_ms,
        "note": status.note.encode("ascii", "replace").decode(), "pending": viewer.source.pending,
    }  # fmt: skip
