"""Parser of protocol files (TOML), which define evaluations."""

import dataclasses
import difflib
import math
import os
import re
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from splatwire.arguments import checked
from splatwire.bitstream import PRESETS, Packetization
from splatwire.errors import DatasetError, InvalidValueError, SplatwireError
from splatwire.evaluation.study.definition import (
    DEFAULT_METRICS,
    SIZE_METRICS,
    SOURCES,
    Decoded,
    Loss,
    Published,
    Row,
    SceneEntry,
    Study,
)
from splatwire.files.names import real_path
from splatwire.types.background import Background, check_background

MAX_FILE_BYTES = 1 << 20
_ARRAYS = ("scene", "loss", "row", "published")
_HEADINGS = {**{name: f"[[{name}]]" for name in _ARRAYS}, "decoded": "[[row.decoded]]"}
"""Headings of tables that may be repeated, by name."""
_VARIABLE = re.compile(r"\$(?:\{(\w+)\}|(\w+))")
_STUDY = {
    "name": str, "title": str, "kind": str, "notes": list, "baseline": str, "seeds": list, "metrics": list,
    "views": int, "lpips_views": int, "renderer": str, "picture_views": int,
}  # fmt: skip
_SCENE = {
    "name": str, "stream": str, "scene": str, "model": str, "photos": str, "cameras": str, "dataset": str,
    "images": str, "split": str, "test_views": str, "max_width": int, "weights": str, "sections": str, "reference": str,
    "background": list,
}  # fmt: skip
_ROW = {
    "key": str, "label": str, "conceal": str, "options": dict, "erode": str, "lossless": bool, "sections": list,
    "curve": str,
}  # fmt: skip
_DECODED_ROW = {"key": str, "label": str, "curve": str, "decoded": list}
_DECODED = {"scene": str, "source": str, "num_bytes": int}
_PACKETIZATION = {field.name: type(field.default) for field in dataclasses.fields(Packetization)}
_LOSS = {"model": str, "unit": str, "send_order": str}
_TYPES = {str: "text", int: "an integer", list: "a list", dict: "a table", bool: "true or false", float: "a number"}


@checked
def load_study(path: Path, *, replaced: SceneEntry | None = None) -> Study:
    """Reads and validates a protocol file (TOML); no computation is started.

    Args:
        path: The file.
        replaced: Scene to evaluate in place of the scenes in the file; None to evaluate the scenes in the file.

    Returns:
        The definition of the evaluation. Relative paths refer to the folder of the file; ${NAME} expands environment
        variables.

    Raises:
        InvalidValueError: If the file is not TOML, a key is unknown, missing or of the wrong type, or a value is
            invalid. The message names the file and the entry.
        DatasetError: If a scene's file or folder does not exist.
    """
    content = _read(path)
    try:
        _check_keys("the file", content, {"protocol": dict, **dict.fromkeys(_ARRAYS, list)})
        header = dict(content.get("protocol", {}))
        _check_keys("[protocol]", header, _STUDY)
        expand = _Expander(path.parent)
        scenes = (
            (replaced,)
            if replaced
            else tuple(_scene(location, table, expand) for location, table in _tables(content, "scene"))
        )
        return Study(
            name=header.pop("name", path.stem),
            title=header.pop("title", path.stem),
            scenes=scenes,
            rows=tuple(_row(location, table, expand) for location, table in _tables(content, "row")),
            losses=tuple(_loss(location, table) for location, table in _tables(content, "loss")),
            published=tuple(
                _parse_published(location, table, header.get("metrics", ()))
                for location, table in _tables(content, "published")
            ),
            **_header(header),
        )
    except DatasetError as error:
        raise DatasetError(f"{path}: {error}") from error
    except SplatwireError as error:
        raise InvalidValueError(f"{path}: {error}") from error


def _read(path: Path) -> dict[str, Any]:
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
        if len(data) > MAX_FILE_BYTES:
            raise InvalidValueError(f"it is no protocol: it is larger than {MAX_FILE_BYTES} bytes")
        content = tomllib.loads(data.decode("utf-8-sig"))
        _check_plain("", content)
    except OSError as error:
        raise DatasetError(f"protocol {path} cannot be read: {error.strerror}") from error
    except RecursionError as error:
        raise InvalidValueError(f"{path} is no protocol: its tables or lists are nested too deeply") from error
    except SplatwireError as error:
        raise InvalidValueError(f"{path}: {error}") from error
    except ValueError as error:  # of the parser, of UTF-8, or of an integer with thousands of digits
        raise InvalidValueError(f"{path} is not valid TOML: {error}") from error
    return content


def _check_plain(location: str, value: Any) -> None:
    """Rejects TOML values that protocol files do not use: dates, non-finite numbers, and integers beyond 64 bits."""
    if isinstance(value, (dict, list)):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value, 1):
            _check_plain(f"{location} {key}".strip()[:80], item)
    elif isinstance(value, float) and not math.isfinite(value):
        raise InvalidValueError(f"{location} must be a finite number, not {value}")
    elif isinstance(value, int) and not -(1 << 63) <= value < 1 << 63:
        raise InvalidValueError(f"{location} is beyond the range of integers in TOML, 64 bits")
    elif not isinstance(value, (str, int, float)):
        kind = type(value).__name__
        raise InvalidValueError(f"{location} must be text, a number, true or false, not the {kind} {value}")


def _tables(content: Mapping[str, Any], name: str) -> list[tuple[str, dict[str, Any]]]:
    """Returns the entries of a TOML array of tables, each with a location text for error messages."""
    tables = content.get(name, [])
    for number, table in enumerate(tables, 1):
        if not isinstance(table, dict):
            raise InvalidValueError(f"{name} {number} is not a table: write {_HEADINGS[name]}")
    return [(f"[[{name}]] {number}", dict(table)) for number, table in enumerate(tables, 1)]


def _check_keys(
    location: str, table: Mapping[str, Any], types: Mapping[str, type], needed: tuple[str, ...] = ()
) -> None:
    for key, value in table.items():
        if key not in types:
            raise InvalidValueError(f"{location} has an unknown key '{key}'{_hint(key, types)}")
        wanted = types[key]
        number = wanted is float and type(value) is int
        if key in _HEADINGS and isinstance(value, dict):
            raise InvalidValueError(f"{location}: {key} has single brackets: write {_HEADINGS[key]}")
        if type(value) is not wanted and not number:
            raise InvalidValueError(f"{location}: {key} must be {_TYPES[wanted]}, not {value!r:.60}")
    for key in needed:
        if key not in table:
            raise InvalidValueError(f"{location} lacks '{key}'")


def _hint(name: str, names: Iterable[str]) -> str:
    names = list(names)
    near = difflib.get_close_matches(name, names, 1)
    return f"; did you mean '{near[0]}'?" if near else f": known are {', '.join(names)}"


def _header(header: Mapping[str, Any]) -> dict[str, Any]:
    kinds = {"seeds": int, "metrics": str, "notes": str}
    for name, kind in kinds.items():
        for value in header.get(name, []):
            if type(value) is not kind:
                raise InvalidValueError(f"[protocol]: {name} must hold {_TYPES[kind]} only, not {value!r:.60}")
    return {name: tuple(value) if name in kinds else value for name, value in header.items()}


@dataclasses.dataclass(frozen=True)
class _Expander:
    """Expands environment variables in a path and checks that the path exists."""

    folder: Path

    def __call__(self, location: str, text: str) -> Path:
        def value(match: re.Match[str]) -> str:
            name = match[1] or match[2]
            if name not in os.environ:
                raise InvalidValueError(f"{location}: the environment variable {name} in '{text}' is not set")
            return os.environ[name]

        meant = _VARIABLE.sub(value, text)
        try:
            path = self.folder / Path(meant).expanduser()
            there = path.exists()
        except (OSError, RuntimeError, ValueError) as error:  # too long; no such user; a null character
            reason = getattr(error, "strerror", None) or error
            raise InvalidValueError(f"{location}: '{text:.60}' is no path: {reason}") from error
        if not there:
            raise DatasetError(f"{location}: {path} does not exist")
        return real_path(path)


def _scene(location: str, table: dict[str, Any], expand: _Expander) -> SceneEntry:
    _check_keys(location, table, _SCENE, ("name",))
    location = f"{location} ({table['name']})"
    kinds = [kind for kind in SOURCES if kind in table]
    if len(kinds) != 1:
        raise InvalidValueError(f"{location} needs one of {', '.join(SOURCES)}; it has {' and '.join(kinds) or 'none'}")
    source = expand(location, table.pop(kinds[0]))
    for key in ("photos", "cameras", "weights", "sections", "reference"):
        if key in table:
            table[key] = expand(location, table[key])
    if "background" in table:
        table["background"] = _background(location, table["background"])
    return SceneEntry(source=source, kind=kinds[0], **table)


def _background(location: str, values: list[Any]) -> Background:
    try:
        return check_background(values)
    except InvalidValueError as error:
        raise InvalidValueError(f"{location}: {error}") from error


def _row(location: str, table: dict[str, Any], expand: "_Expander") -> Row:
    if "decoded" in table:
        return _decoded_row(location, table, expand)
    _check_keys(location, table, {**_ROW, "preset": str, **_PACKETIZATION}, ("key", "label"))
    location = f"{location} ({table['key']})"
    try:
        preset = table.pop("preset", "paper")
        if preset not in PRESETS:
            raise InvalidValueError(f"unknown preset '{preset}'{_hint(preset, PRESETS)}")
        changes = {key: table.pop(key) for key in list(table) if key in _PACKETIZATION}
        packetization = dataclasses.replace(PRESETS[preset], **changes)
        table["sections"] = tuple(_texts(location, "sections", table.pop("sections", [])))
        return Row(packetization=packetization, **table)
    except SplatwireError as error:
        raise InvalidValueError(f"{location}: {error}") from error


def _decoded_row(location: str, table: dict[str, Any], expand: "_Expander") -> Row:
    """Parses a `[[row]]` table of a study's TOML file that lists scenes decoded by another codec.

    Args:
        location: Place of the row in the file, for messages.
        table: Keys and values of the TOML table.
        expand: Function that replaces variables in paths.
    """
    _check_keys(location, table, _DECODED_ROW, ("key", "label"))
    location, rows = f"{location} ({table['key']})", []
    try:
        for inner, values in _tables(table, "decoded"):
            inner = f"{location} {inner}"
            _check_keys(inner, values, _DECODED, ("scene", "source"))
            rows.append(Decoded(values["scene"], expand(inner, values["source"]), values.get("num_bytes")))
        if not rows:
            raise InvalidValueError("it has no result: write [[row.decoded]]")
        curve = table.get("curve", "")
        return Row(table["key"], table["label"], None, lossless=True, decoded=tuple(rows), curve=curve)
    except DatasetError:
        raise
    except SplatwireError as error:
        raise InvalidValueError(f"{location}: {error}") from error


def _texts(location: str, key: str, values: list[Any]) -> list[str]:
    for value in values:
        if type(value) is not str:
            raise InvalidValueError(f"{location}: {key} must hold text only, not {value!r:.60}")
    return values


def _loss(location: str, table: dict[str, Any]) -> Loss:
    _check_keys(location, table, _LOSS, ("model",))
    try:
        return Loss(**table)
    except SplatwireError as error:
        raise InvalidValueError(f"{location}: {error}") from error


def _parse_published(location: str, table: dict[str, Any], metrics: Iterable[Any]) -> Published:
    """Parses one table `[[published]]` of a protocol file: published results of a method on a dataset.

    Args:
        location: Position of the table in the file, for messages.
        table: Keys and values of the table.
        metrics: Names of further metrics that the table may contain.

    Raises:
        InvalidValueError: If a key is missing or unknown, or the table has no result.
    """
    figures = tuple(dict.fromkeys((*DEFAULT_METRICS, *SIZE_METRICS, *filter(_is_text, metrics))))
    _check_keys(location, table, {"row": str, "dataset": str, **dict.fromkeys(figures, float)}, ("row", "dataset"))
    values = {metric: float(table[metric]) for metric in figures if metric in table}
    if not values:
        raise InvalidValueError(f"{location} has no figure: give {', '.join(figures)}")
    return Published(table["row"], table["dataset"], values)


def _is_text(value: Any) -> bool:
    return type(value) is str
