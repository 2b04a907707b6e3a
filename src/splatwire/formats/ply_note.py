"""A note in a PLY, for who reads the Gaussians exactly as they were written: what they were rounded to.

The header has it as a comment, with a digest of the rows: who changes a row makes it void. A byte for each row stands
where the first component of its normal would be, which 3DGS leaves at 0 and nobody reads.
"""

import base64
import binascii
import hashlib
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatwire.errors import DatasetError
from splatwire.files.capped import open_regular

DIGEST_DIGITS = 32
_HEAD_BYTES = 8192
_COMMENT = re.compile(rb"\ncomment splatwire-steps ([0-9a-f]{32}) ([A-Za-z0-9+/=]{1,2000})\n")
_TYPES = {b"float": "<f4", b"double": "<f8"}
_ROWS = re.compile(rb"\nelement vertex ([0-9]{1,9})\n")
_NORMAL = "nx"
"""Property that holds the marks."""
_COLUMN = 3
"""Its column among those that are written."""
_PROPERTY = re.compile(rb"\nproperty (float|double) (\w+)(?=\n)")


@dataclass(frozen=True, eq=False)
class PlyNote:
    """What is noted.

    Attributes:
        content: Of all Gaussians.
        marks: Of each, uint8 (N).
    """

    content: bytes
    marks: np.ndarray

    def line(self, digest: str) -> str:
        """The comment."""
        return f"comment splatwire-steps {digest} {base64.b64encode(self.content).decode()}"


def read_note(path: Path) -> PlyNote | None:
    """The note of a PLY that was written with one and is unchanged; else None.

    Raises:
        DatasetError: If it is no ordinary file.
        OSError: If it cannot be read.
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
        return PlyNote(content, rows[_NORMAL].astype(np.uint8))


def marked(rows: np.ndarray, marks: np.ndarray) -> np.ndarray:
    """Rows with a mark each."""
    found = rows.copy()
    found[:, _COLUMN] = marks
    return found
