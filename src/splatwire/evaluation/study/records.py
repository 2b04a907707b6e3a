"""Records: settings and scores of one view, stored in Parquet files with one file per task."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

from splatwire.errors import BackendUnavailableError, BitstreamError
from splatwire.version import __version__

PROTOCOL_VERSION = 3
"""Version of the computation, increased if equal inputs give other scores; results of other versions are not reused."""
CODE = f"{__version__}/{PROTOCOL_VERSION}"

TIMINGS = ("seconds_decode", "seconds_conceal", "seconds_render", "seconds_score")
"""Fields that differ between executions; all other fields are reproducible."""
RECORD_KEY = ("study", "row", "label")
"""Leading columns of the output file with all records; they identify the table row (method)."""


@dataclass(frozen=True)
class Record:
    """Settings and scores of one view in one task; the fields are the columns of a Parquet file.

    Attributes:
        unit: Key of the task.
        scene: Name of the scene.
        stream: Name of the stream.
        mask: Digest of the loss mask; empty without loss.
        loss: The loss model; `none` without loss.
        loss_unit: Unit of loss, packet or datagram; None without loss.
        send_order: Order of sending; None without loss.
        conceal: Name of the concealer.
        options: Options of the concealer, canonical JSON.
        erode: The one attribute that is removed from anchors in lost packets; None if all attributes are removed.
        view: Name of the view.
        renderer: Name of the renderer.
        code: Version of the code.
        seed: Seed of the mask; None without loss.
        view_index: Index of the view.
        num_anchors: Number of elements of the complete scene.
        num_lost_anchors: Number of elements with at least one lost attribute.
        num_packets: Number of packets of the complete stream.
        num_lost_packets: Number of lost packets.
        num_datagrams: Number of datagrams sent; None without loss.
        num_lost_datagrams: Number of lost datagrams; None without loss.
        num_bytes_received: Received bytes of the stream.
        psnr: PSNR in decibels, infinite if the image equals its reference; None if not measured.
        ssim: Structural similarity; None if not measured.
        lpips: LPIPS; None if not measured.
        seconds_decode: Decoding time in seconds.
        seconds_conceal: Concealment time in seconds, for all views together.
        seconds_render: Rendering time of this view, seconds.
        seconds_score: Scoring time of this view, seconds.
        others: Other metrics by name, one column each; None if not measured.
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
    others: Mapping[str, float | None] = field(default_factory=dict)

    def figure(self, metric: str) -> float | None:
        """Returns the value of a metric by name, or None if the metric was not measured."""
        value: float | None = self.others[metric] if metric in self.others else getattr(self, metric)
        return value

    def row(self) -> dict[str, Any]:
        """Returns the columns of the record by name, one row of a table."""
        own = {name: value for name, value in vars(self).items() if name != "others"}
        return own | dict(self.others)

    @staticmethod
    def of(row: Mapping[str, Any]) -> "Record":
        """Converts a table row, a mapping from column names to values, back to a record.

        Raises:
            TypeError: If a column is missing.
        """
        field_names = {item.name for item in fields(Record)} - {"others"}
        own = {name: value for name, value in row.items() if name in field_names}
        return Record(**own, others={name: value for name, value in row.items() if name not in field_names})


RECORD_COLUMNS = {item.name for item in fields(Record)} - {"psnr", "ssim", "lpips"} | set(RECORD_KEY)
"""Column names of records, which metrics must not use."""


def hardest(records: Sequence[Record], count: int) -> tuple[int, ...]:
    """Returns the indices of the views with the lowest PSNR, lowest first."""
    order = sorted(range(len(records)), key=lambda view: records[view].psnr or 0.0)
    return tuple(order[:count])


def parquet() -> tuple[Any, Any]:
    """Imports the optional Parquet library; returns the modules `pyarrow.parquet` and `pyarrow`.

    Raises:
        BackendUnavailableError: If the library is not installed.
    """
    try:
        import pyarrow.parquet
    except ImportError as error:
        raise BackendUnavailableError("pyarrow", "pip install 'splatwire[tables]'") from error
    return pyarrow.parquet, pyarrow


def _schema(pyarrow: Any, labels: Sequence[str], others: Sequence[str]) -> Any:
    kinds = {str: pyarrow.string(), int: pyarrow.int64(), float: pyarrow.float64()}
    columns = [(name, kinds[str]) for name in labels]
    for column in fields(Record):
        if column.name == "others":
            continue
        kind: Any = getattr(column.type, "__args__", (column.type,))[0]
        columns.append((column.name, kinds[kind]))
    columns += [(name, kinds[float]) for name in others]
    return pyarrow.schema(columns)


def records_to_bytes(records: Sequence[Record]) -> bytes:
    """Serialises records as a Parquet file; equal records give equal bytes."""
    return table_to_bytes([record.row() for record in records])


def table_to_bytes(rows: Sequence[Mapping[str, Any]], labels: Sequence[str] = ()) -> bytes:
    """Serialises records (scores of one view in one task) as a Parquet file.

    Args:
        rows: Records as mappings from column names to values.
        labels: Names of additional text columns, which precede the columns for the fields of `Record`.
    """
    pq, pyarrow = parquet()
    columns, buffer = {item.name for item in fields(Record)} | set(labels), io.BytesIO()
    others = [name for name in (rows[0] if rows else {}) if name not in columns]
    table = pyarrow.Table.from_pylist([dict(row) for row in rows], schema=_schema(pyarrow, labels, others))
    pq.write_table(table, buffer, compression="zstd")
    return buffer.getvalue()


def records_from_bytes(data: bytes, name: str) -> list[Record]:
    """Reads records from the output of `records_to_bytes`.

    Args:
        data: The output.
        name: Name of the file, for messages.

    Raises:
        BitstreamError: If the data is damaged.
    """
    pq, pyarrow = parquet()
    try:
        return [Record.of(row) for row in pq.read_table(pyarrow.BufferReader(data)).to_pylist()]
    except (pyarrow.ArrowException, TypeError) as error:
        raise BitstreamError(f"{name} is not a file of records: {error}; remove it and start again") from error
