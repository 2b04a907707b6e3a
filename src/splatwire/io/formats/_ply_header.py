"""PLY header: elements, the properties of their rows, and the encoding."""

import logging
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatwire.errors import DatasetError
from splatwire.files.kinds import format_error

LOG = logging.getLogger(__name__)
MAX_ROWS = 20_000_000
_MAX_HEADER_BYTES = 65_536
_MAX_PROPERTIES = 1024
_MAX_ELEMENTS = 16
_MAX_LINE = 120
_FIRST_LINE = re.compile(rb"ply[ \t]*(\r\n|\n|\r)")
_REMARKS = (b"comment", b"obj_info")
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float": "f4",
    "double": "f8",
    "float32": "f4",
    "float64": "f8",
    "half": "f2",
    "float16": "f2",
    "int64": "i8",
    "uint64": "u8",
}
_PREFIX = re.compile(r"^(?:scalar_)?(?:scal_)?(?=(?:f_dc|f_rest|scale|rot)_\d|opacity$|filter_3D$)")
"""Prefixes that CloudCompare, and programs that write files for it, put before the names of Gaussian properties."""
_ASCII_BYTES = 2
"""Minimum number of bytes of a number and its separator in a text PLY."""


@dataclass(frozen=True)
class PlyHeader:
    """Parsed PLY header.

    Attributes:
        order: Byte order of binary data, `<` or `>`; empty for text.
        elements: Number of rows and row type (structured dtype) of each element, up to the first one with lists.
        list_element: Name of the first element with list properties, which is not read; None if no element has any.
        list_properties: Names of the list properties of the element `list_element`.
        unread: Names of the elements after the element `list_element`, if they have rows. They are not read either.
        comments: Text of each comment, without the word `comment`.
    """

    order: str
    elements: dict[str, tuple[int, np.dtype]]
    list_element: str | None
    comments: tuple[str, ...] = ()
    list_properties: tuple[str, ...] = ()
    unread: tuple[str, ...] = ()

    @property
    def num_bytes(self) -> int:
        """Total size of the element rows in bytes; for a text file, the minimum size."""
        sizes = (_ASCII_BYTES * len(d.names or ()) if not self.order else d.itemsize for _, d in self.elements.values())
        counts = (count for count, _ in self.elements.values())
        return sum(count * size for count, size in zip(counts, sizes, strict=True)) - (not self.order)


def read_header(path: Path, source: Iterator[bytes]) -> tuple[PlyHeader, bytes]:
    """Parses the header from the chunks of a file.

    Args:
        path: The file, for messages.
        source: Iterator over the bytes of the file in chunks.

    Returns:
        The header, and the bytes after it in the last chunk read.

    Raises:
        DatasetError: If it is not a PLY header, or too long.
    """
    data = b""
    while True:
        piece = next(source, b"")
        data += piece
        first = _FIRST_LINE.match(data)
        newline = first[1] if first else b"\n"
        # some programs write spaces at the end of lines
        end_mark = re.search(newline + rb"end_header[ \t]*" + newline, data[: _MAX_HEADER_BYTES + _MAX_LINE])
        if end_mark and end_mark.start() <= _MAX_HEADER_BYTES:
            return _parse(path, data[: end_mark.start()], newline), data[end_mark.end() :]
        if first and len(data) > _MAX_HEADER_BYTES:
            raise DatasetError(
                f"{path}: the PLY header is longer than {_MAX_HEADER_BYTES:,} bytes: shorten its comments"
            )
        if not piece or len(data) > _MAX_HEADER_BYTES:
            raise DatasetError(format_error(path, "a PLY file", f"no end_header in the first {len(data)} bytes"))


def _parse(path: Path, head: bytes, newline: bytes) -> PlyHeader:
    lines = [line.strip() for line in head.split(newline)]
    comments = _comments(path, [line for line in lines if line.startswith(_REMARKS)])
    lines = [line for line in lines if line and not line.startswith(_REMARKS)]
    try:
        texts = [line.decode("ascii") for line in lines]
    except UnicodeDecodeError as error:
        raise DatasetError(f"{path}: the PLY header is not ASCII text") from error
    if bad_line := next(
        (text for text in texts if len(text) > _MAX_LINE or not text.replace("\t", " ").isprintable()), ""
    ):
        raise DatasetError(f"{path}: {bad_line[:80]!r} is no line of a PLY header")
    words = [text.split() for text in texts]
    format_words = words[1] if len(words) > 1 else []
    if (
        words[:1] != [["ply"]]
        or len(format_words) != 3
        or format_words[0] != "format"
        or format_words[1] not in _ORDERS
        or format_words[2] != "1.0"
    ):
        raise DatasetError(
            format_error(path, "a PLY file of version 1.0", f"it starts with {' / '.join(texts[:2])[:80]!r}")
        )
    order = _ORDERS[format_words[1]]
    elements, lists, unread = _elements(path, words[2:], order or "<")
    return PlyHeader(order, elements, next(iter(lists), None), comments, next(iter(lists.values()), ()), unread)


def _comments(path: Path, lines: list[bytes]) -> tuple[str, ...]:
    """Decodes the comments of a PLY header.

    Args:
        path: The file, for messages.
        lines: The comment lines of the header.
    """
    texts, others = list[str](), list[str]()
    for line in lines:
        text = line.partition(b" " if b"\t" not in line[:9] else b"\t")[2].strip()
        try:
            texts.append(text.decode("utf-8"))
        except UnicodeDecodeError:
            texts.append(text.decode("cp1252", "replace"))
            others.append(texts[-1])
    if others:
        more = f" (and {len(others) - 1:,} more)" if len(others) > 1 else ""
        LOG.warning("%s: the comment %.80r%s is not UTF-8: it is read as Windows-1252", path, others[0], more)
    return tuple(texts)


def _elements(
    path: Path, lines: list[list[str]], order: str
) -> tuple[dict[str, tuple[int, np.dtype]], dict[str, tuple[str, ...]], tuple[str, ...]]:
    """Parses the lines of the elements of a PLY header.

    Args:
        path: The file, for messages.
        lines: Words of each line.
        order: Byte order of binary data, `<` or `>`.

    Returns:
        Three items:

        * Number of rows and row type by element, up to the first element with list properties.
        * Names of the list properties by element.
        * Names of the elements with rows after the first element with list properties.
    """
    elements: dict[str, tuple[int, list[tuple[str, str]]]] = {}
    lists: dict[str, tuple[str, ...]] = {}
    for words in lines:
        line = " ".join(words)[:80]
        if words[0] == "element":
            name, count = _element(path, words)
            if name in elements or len(elements) == _MAX_ELEMENTS:
                raise DatasetError(f"{path}: {line!r} is there twice, or more than {_MAX_ELEMENTS} elements")
            elements[name] = (count, [])
        elif not elements or words[0] != "property":
            raise DatasetError(f"{path}: expected an element or a property of one, found {line!r}")
        elif len(words) == 5 and words[1] == "list" and words[2] in _TYPES and words[3] in _TYPES:
            name = list(elements)[-1]
            lists[name] = (*lists.get(name, ()), words[4])
        elif len(words) == 3 and words[1] in _TYPES:
            list(elements.values())[-1][1].append((words[2], order + _TYPES[words[1]]))
        else:
            raise DatasetError(f"{path}: expected a property of one number, found {line!r}")
    # gsplat writes an element `sh` without properties for harmonics of degree 0
    elements = {name: parts for name, parts in elements.items() if parts[1] or name in lists or name == "vertex"}
    elements_without_lists: dict[str, tuple[int, np.dtype]] = {}
    for name, (count, fields) in elements.items():
        if name in lists:
            break
        if not 0 < len({field for field, _ in fields}) == len(fields) <= _MAX_PROPERTIES:
            limits = f"1 to {_MAX_PROPERTIES}, all different, are allowed"
            raise DatasetError(f"{path}: element {name} has {len(fields)} properties ({limits})")
        elements_without_lists[name] = (count, np.dtype(_without_prefixes(fields)))
    after = list(elements)[len(elements_without_lists) + 1 :]
    return elements_without_lists, lists, tuple(name for name in after if elements[name][0])


def _without_prefixes(fields: list[tuple[str, str]]) -> list[tuple[str, str]]:
    """Removes the prefixes of Gaussian properties where no other property then has the same name."""
    plain = [_PREFIX.sub("", name, count=1) for name, _ in fields]
    return [
        (short if plain.count(short) == 1 else name, kind) for short, (name, kind) in zip(plain, fields, strict=True)
    ]


def _element(path: Path, words: list[str]) -> tuple[str, int]:
    line = " ".join(words)[:80]
    if len(words) != 3 or not words[2].isdigit():
        raise DatasetError(f"{path}: {line!r} is no element with a number of rows")
    if len(words[2]) > 12 or int(words[2]) > MAX_ROWS:
        raise DatasetError(f"{path}: {words[2][:20]} rows of {words[1][:40]} are more than the limit of {MAX_ROWS}")
    return words[1], int(words[2])
