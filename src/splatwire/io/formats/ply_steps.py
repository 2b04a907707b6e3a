"""Quantisation steps of decoded Gaussians, stored in a PLY for lossless re-encoding.

A header comment has the steps and a digest of the vertices; after a change of the vertices, the steps are ignored. The
precision class of each Gaussian is stored as the first component of its normal, which 3DGS ignores.
"""

import base64
import binascii
import hashlib
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatwire.arguments import CheckedFields, checked
from splatwire.errors import DatasetError
from splatwire.files.read_limited import open_regular
from splatwire.reprs import summary_repr

DIGEST_DIGITS = 32
_HEAD_BYTES = 8192
_COMMENT = re.compile(rb"\ncomment splatwire-steps ([0-9a-f]{32}) ([A-Za-z0-9+/=]{1,2000})\n")
_TYPES = {b"float": "<f4", b"double": "<f8"}
_ROWS = re.compile(rb"\nelement vertex ([0-9]{1,9})\n")
_NORMAL = "nx"
"""Name of the property that stores the precision class of each Gaussian."""
_COLUMN = 3
"""Index of that property among the written properties."""
_PROPERTY = re.compile(rb"\nproperty (float|double) (\w+)(?=\n)")


@dataclass(frozen=True, eq=False)
class PlySteps(CheckedFields):
    """Quantisation steps of decoded Gaussians in the form that a PLY stores.

    Attributes:
        content: Encoded quantisation parameters of the scene, among them the steps of class 0.
        classes: Precision class of each Gaussian, which selects its quantisation steps, uint8 (N); 0 is the coarsest.
    """

    content: bytes
    classes: np.ndarray

    __repr__ = summary_repr

    def line(self, digest: str) -> str:
        """Returns the header comment of a PLY with the quantisation steps and the digest of the vertices."""
        return f"comment splatwire-steps {digest} {base64.b64encode(self.content).decode()}"


@checked
def read_ply_steps(path: Path) -> PlySteps | None:
    """Returns the quantisation steps stored in a PLY.

    The result is None if the file has no steps, or its Gaussians were changed after the steps were stored.

    Raises:
        DatasetError: If the file is not an ordinary file.
        OSError: If the file cannot be read.
    """
    with open_regular(path, DatasetError) as file:
        head, mark, _ = file.read(_HEAD_BYTES).partition(b"end_header\n")
        comment, count = _COMMENT.search(head), _ROWS.search(head)
        if not mark or comment is None or count is None:
            return None
        fields = [(name.decode(), _TYPES[kind]) for kind, name in _PROPERTY.findall(head)]
        if len({name for name, _ in fields}) < len(fields) or _NORMAL not in dict(fields):
            return None
        record = np.dtype(fields)
        size = int(count[1]) * record.itemsize
        file.seek(0, 2)
        if file.tell() != len(head) + len(mark) + size:
            return None
        file.seek(len(head) + len(mark))
        rows = np.frombuffer(file.read(size), record)
    if hashlib.sha256(rows.view(np.uint8).data).hexdigest()[:DIGEST_DIGITS] != comment[1].decode():
        return None
    try:
        content = base64.b64decode(comment[2], validate=True)
    except binascii.Error:
        return None
    with np.errstate(invalid="ignore"):
        return PlySteps(content, rows[_NORMAL].astype(np.uint8))


def with_classes(rows: np.ndarray, classes: np.ndarray) -> np.ndarray:
    """Stores each Gaussian's precision class in a copy of the vertices, in place of the normal vector's x component.

    Splat viewers ignore the normal vectors of a PLY.

    Args:
        rows: Properties of the vertices in file order, (N, P).
        classes: Precision class of each Gaussian, uint8 (N).
    """
    changed = rows.copy()
    changed[:, _COLUMN] = classes
    return changed
