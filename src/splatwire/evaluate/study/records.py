"""Records: one per view of a unit, and Parquet files that hold them."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from splatwire.errors import BackendUnavailableError, BitstreamError
from splatwire.version import __version__

PROTOCOL_VERSION = 2
"""Raised when the same inputs come to give other records: what another version left in a store is not used."""
CODE = f"{__version__}/{PROTOCOL_VERSION}"

TIMINGS = ("seconds_decode", "seconds_conceal", "seconds_render", "seconds_score")
"""The only fields that differ from run to run."""
PLACE = ("study", "row", "label")
"""Columns that merged records have before all others."""


@dataclass(frozen=True)
class Record:
    """How one view of one unit was drawn and scored; the fields are the columns of a Parquet file.

    Attributes:
        unit: Key of the unit.
        scene: Name of the scene.
        stream: Name of the stream.
        mask: Digest of which packets arrived; empty without loss.
        loss: The loss model, `none` without.
        loss_unit: What is lost as one; None without loss.
        send_order: Order of sending; None without loss.
        conceal: Name of the concealer.
        options: Its options, canonical JSON.
        erode: The one attribute that lost anchors lose; None for all.
        view: Name of the view.
        renderer: Name of the renderer.
        code: Version of the code.
        seed: Seed of the mask; None without loss.
        view_index: Index of the view.
        num_anchors: Anchors of the complete scene.
        num_lost_anchors: Anchors that lost something.
        num_packets: Packets of the complete stream.
        num_lost_packets: Packets lost.
        num_datagrams: Datagrams sent; None without loss.
        num_lost_datagrams: Datagrams lost; None without loss.
        num_bytes_received: Bytes of the stream that arrived.
        psnr: Decibels, infinite where the picture equals its reference; None if not measured, as for what follows.
        ssim: Structural similarity.
        lpips: LPIPS.
        seconds_decode: Seconds that decoding took, shared by the rows of one received stream.
        seconds_conceal: Seconds that concealing took, once for all views.
        seconds_render: Seconds that drawing this view took.
        seconds_score: Seconds that scoring this view took.
    """

    unit: str
    scene: str
    stream: str
    mask: str
    loss: str
    loss_unit: str | None
    send_order: str | None
    conceal: str
    options: str
    erode: str | None
    view: str
    renderer: str
    code: str
    seed: int | None
    view_index: int
    num_anchors: int
    num_lost_anchors: int
    num_packets: int
    num_lost_packets: int
    num_datagrams: int | None
    num_lost_datagrams: int | None
    num_bytes_received: int
    psnr: float | None
    ssim: float | None
    lpips: float | None
    seconds_decode: float
    seconds_conceal: float
    seconds_render: float
    seconds_score: float


def hardest(records: Sequence[Record], count: int) -> tuple[int, ...]:
    """The views with the lowest PSNR, hardest first; the first ones where PSNR was not measured."""
    order = sorted(range(len(records)), key=lambda view: records[view].psnr or 0.0)
    return tuple(order[:count])


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


def _schema(place: Sequence[str]) -> Any:
    import pyarrow

    kinds = {str: pyarrow.string(), int: pyarrow.int64(), float: pyarrow.float64()}
    columns = [(name, kinds[str]) for name in place]
    for column in fields(Record):
        kind: Any = getattr(column.type, "__args__", (column.type,))[0]
        columns.append((column.name, kinds[kind]))
    return pyarrow.schema(columns)


def records_to_bytes(records: Sequence[Record]) -> bytes:
    """Writes records as a Parquet file; the same records give the same bytes."""
    return table_to_bytes([vars(record) for record in records])


def table_to_bytes(rows: Sequence[Mapping[str, Any]], place: Sequence[str] = ()) -> bytes:
    """Writes the fields of records, behind further columns of text, as a Parquet file."""
    pq = parquet()
    import pyarrow

    buffer = io.BytesIO()
    table = pyarrow.Table.from_pylist([dict(row) for row in rows], schema=_schema(place))
    pq.write_table(table, buffer, compression="zstd")
    return buffer.getvalue()


def records_from_bytes(data: bytes, name: str) -> list[Record]:
    """Reads what `records_to_bytes` wrote.

    Raises:
        BitstreamError: If it is damaged.
    """
    pq = parquet()
    import pyarrow

    try:
        return [Record(**row) for row in pq.read_table(pyarrow.BufferReader(data)).to_pylist()]
    except (pyarrow.ArrowException, TypeError) as error:
        raise BitstreamError(f"{name} is not a file of records: {error}; remove it and start again") from error
