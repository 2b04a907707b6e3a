"""Records: one line per view of a unit, and Parquet files that hold them."""

import io
from collections.abc import Mapping, Sequence
from typing import Any

from splatwire.errors import BackendUnavailableError, BitstreamError

TIMINGS = ("seconds_decode", "seconds_conceal", "seconds_render", "seconds_score")
"""The only columns that differ from run to run."""
_TEXT = ("unit", "scene", "stream", "mask", "loss", "loss_unit", "send_order", "conceal", "options", "erode", "view",
         "renderer", "code")  # fmt: skip
_COUNTS = ("seed", "view_index", "num_anchors", "num_lost_anchors", "num_packets", "num_lost_packets", "num_datagrams",
           "num_lost_datagrams", "num_bytes_received")  # fmt: skip
_NUMBERS = ("psnr", "ssim", "lpips", *TIMINGS)
PLACE = ("study", "row", "label")
"""Columns that merged records have before all others."""


def parquet() -> Any:
    """The Parquet library.

    Raises:
        BackendUnavailableError: If it is not installed.
    """
    try:
        import pyarrow.parquet
    except ImportError as error:
        raise BackendUnavailableError("pyarrow", "pip install 'splatwire[tables]'") from error
    return pyarrow.parquet


def _schema(place: Sequence[str] = ()) -> Any:
    import pyarrow

    columns = [(name, pyarrow.string()) for name in (*place, *_TEXT)]
    columns += [(name, pyarrow.int64()) for name in _COUNTS]
    return pyarrow.schema(columns + [(name, pyarrow.float64()) for name in _NUMBERS])


def records_to_bytes(records: Sequence[Mapping[str, Any]], *, merged: bool = False) -> bytes:
    """Writes records as a Parquet file; the same records give the same bytes.

    Args:
        records: One mapping per view; columns that are absent are null.
        merged: Whether the columns that place a record in a table are there, too.
    """
    pq = parquet()
    import pyarrow

    buffer = io.BytesIO()
    table = pyarrow.Table.from_pylist([dict(record) for record in records], schema=_schema(PLACE if merged else ()))
    pq.write_table(table, buffer, compression="zstd")
    return buffer.getvalue()


def records_from_bytes(data: bytes, name: str) -> list[dict[str, Any]]:
    """Reads a Parquet file of records.

    Raises:
        BitstreamError: If it is damaged.
    """
    pq = parquet()
    import pyarrow

    try:
        rows: list[dict[str, Any]] = pq.read_table(pyarrow.BufferReader(data)).to_pylist()
    except pyarrow.ArrowException as error:
        raise BitstreamError(f"{name} is not a file of records: {error}; remove it and start again") from error
    return rows
