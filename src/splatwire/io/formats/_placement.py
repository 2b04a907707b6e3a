"""Warns of PLY comments and JSON fields that may change the meaning of a scene's values but are not applied.

Such comments and fields may describe shifts, scales, axes and units of positions, or the encoding of opacities, scales
and colours.
"""

import logging
import os
import re
from collections.abc import Iterable
from pathlib import Path

from splatwire.errors import DatasetError
from splatwire.files.read_limited import read_at_most
from splatwire.io.formats.ply_comments import OFFSET, ORIGIN, stated_origin
from splatwire.io.formats.ply_metadata import invalid_view, is_metadata, named_up, names_up
from splatwire.types.origin import describe_origin

LOG = logging.getLogger(__name__)
_WORDS = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|[-+]?(?:\d[\d',]*\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
"""Words and numbers of a comment, also those of names such as `globalShift` and `shift_x`."""
_SHIFTS = frozenset(
    (
        "shift",
        "shifts",
        "shifted",
        "offset",
        "offsets",
        "translation",
        "translate",
        "translated",
        "origin",
        "center",
        "centre",
        "centroid",
        "datum",
        "anchor",
        "easting",
        "northing",
        "latitude",
        "longitude",
        "lat",
        "lon",
        "latlon",
        "lla",
        "llh",
        "altitude",
        "utm",
        "mgrs",
        "gps",
        "geolocation",
        "ecef",
        "recenter",
        "recentered",
        "recentred",
        "normalization",
        "normalisation",
        "similarity",
        *(f"{word}{axis}" for word in ("shift", "offset", "translation", "origin", "center") for axis in "xyz"),
        "transform",
        "transformation",
        "matrix",
    )
)
_ALONG_AXIS = re.compile(r"(?:shift|offset|translat(?:e|ion)|origin|cent(?:er|re))[-_ ]?[xyz]\b", re.I)
"""Pattern of the names of shifts along one axis."""
_SYSTEMS = re.compile(r"\b(?:epsg|crs|srs|wkt|proj4?|utm[-_ ]?zone|wgs[-_ ]?84|geo[-_ ]?ref\w*|projcs|geogcs)\b", re.I)
_POINTS = re.compile(r"\b(?:ref(?:erence)?|base|local|world|geo)[-_ ]?(?:point|position|pos|coord\w*)\b", re.I)
_POSES = re.compile(
    r"\b(?:sim[-_ ]?3|se[-_ ]?3|(?:mean|median|average)(?:[-_ ]?(?:xyz|pos|positions?|points?|coord\w*))?|"
    r"(?:\w+[-_ ])?pose|(?:world|local|model|scene|object|map|global|geo|ecef|enu|ned)[-_ ]?(?:to|2|from)[-_ ]?[a-z]+|"
    r"[a-z]2w|w2[a-z]|t[-_ ]?(?:[cwlbmg]{2}|(?:[a-z]+[-_ ])?(?:world|local|model))|"
    r"(?:geo)?(?:registration|location|position)|align(?:ment)?)"
    r"(?P<values>(?:[\s:=,;()\[\]]+[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?){3,})",
    re.I,
)
"""Pattern of names of poses, similarities and mean positions that are followed by three or more numbers."""
_TURNS = re.compile(
    r"(?:rotat(?:e|ed|ion)|quaternion|euler(?:[-_ ]angles)?|flip(?:ped)?|mirror(?:ed)?|swap(?:ped)?)"
    r"(?:[-_ :=,()\[\]]*(?:axis|about|around|by|[xyz]+|yes|true|[-+\d.]+))+",
    re.I,
)
_SCALES = frozenset(("scale", "scaled", "scaling", "scalefactor", "multiply", "multiplied", "multiplier"))
_UNITS = frozenset(("unit", "units", "meters", "metres", "metersperunit"))
_LENGTHS = re.compile(
    r"\b(?:cm|mm|millimet(?:er|re)s?|centimet(?:er|re)s?|kilomet(?:er|re)s?|inch(?:es)?|feet|foot|yards?)\b", re.I
)
_METRES = frozenset(("m", "meter", "meters", "metre", "metres", "1"))
_AXES = re.compile(
    r"\b(?:axis|axes|handed(?:ness)?|right-?handed|left-?handed|(?:coordinate|coord|axis|world)[-_ ]?(?:system|frame|"
    r"convention|space)|opengl|opencv|[xyz][-_ ]?up)\b|\bup[-_ ]?(?:axis|vector|dir(?:ection)?)?\s*[:=]"
    r"|\bup[-_ ]?(?:axis|vector|dir(?:ection)?)\b|^\s*up\s+[-+]?(?:[xyz]\b|\d)|[xyz]_up",
    re.I,
)
_OWN_AXES = re.compile(r"\b(?:RDF|3DGS|colmap|opencv)\b", re.I)
"""Names of the axis convention of this package; comments that name it are not logged."""
_PROGRAM = re.compile(
    r"\s*(?:generator|(?:generated|created|exported|written|made|produced|saved|converted)\s+(?:by|in|using|from))\b",
    re.I,
)
"""Start of comments with the name and version of a program."""
_TOOL = re.compile(r"\b\w+-transform\b(?:\s+v?[\d.]+)?", re.I)
"""Names of programs such as PlayCanvas' `splat-transform`, and their version."""
_VECTOR = 3
_MATRICES = {9: (3, 3), 12: (3, 4), 16: (4, 4)}
"""Numbers of rows and columns of a matrix, by its number of values."""
_OTHER_VALUES = (
    (
        re.compile(
            r"(?:opacit(?:y|ies)|alphas?|scales?)\b(?!.*\bnot\b).*\b(?:linear|activated|sigmoid\w*|exp|exponentiated|"
            r"uint8|bytes?|0\s*(?:-|\.\.|to)\s*(?:1|100|255))\b",
            re.I,
        ),
        "another unit of opacities or scales",
    ),
    (re.compile(r"\b(?:xyzw|quat\w*[-_ ]order\W+x|scalar[-_ ]last)\b", re.I), "another order of the rotations"),
    (
        re.compile(
            r"colou?r[-_ ]?(?:space|profile)\W+(?!\W*s?rgb\b)\w|\blinear[-_ ]?s?rgb\b|\bgamma\W+\d|\bacescg\b", re.I
        ),
        "another colour space",
    ),
)
"""Patterns of comments about the values of Gaussians, and their meanings."""
_SURVEY_BYTES = 1 << 16
"""Size of the part of a `metadata.xml` that is searched for its origin, bytes."""
_MAX_NUMBERS = 32
"""Maximum number of values of a list or object that may be a vector or a matrix."""
_MAX_BETWEEN = 4
"""Maximum number of words between a keyword and its number."""
_PIECE = 1000
"""Number of characters that are searched at once: the time of some patterns grows with the square of this number."""
_OVERLAP = 200
"""Number of characters that two pieces share, so that a keyword and its numbers are in one of them."""


def warn_of_unused_comments(path: Path, comments: Iterable[str], keyword: str) -> None:
    """Logs a warning about each PLY comment that may change the scene, for example by a shift, but is not applied.

    Args:
        path: The file.
        comments: Text of each comment, without the word `comment`.
        keyword: First word of the comments that state the scene's origin: `ORIGIN` or `OFFSET`. The reader applies the
            first valid comment with this word. An invalid comment with this word, or one with a different origin,
            causes a warning.
    """
    all_comments = tuple(comments)
    used = stated_origin(keyword, all_comments)
    for comment in all_comments:
        word = comment.split()[:1]
        if word == [keyword]:
            if (stated := stated_origin(keyword, [comment])) is None:
                LOG.warning("%s: comment %.80r is not three numbers within 1e12: it is left out", path, comment)
            elif stated != used:
                LOG.warning(
                    "%s: comment %.80r differs from an earlier one: (%s) is used",
                    path, comment, "no origin" if used is None else describe_origin(used),
                )  # fmt: skip
        elif (problem := invalid_view(comment)) is not None:
            LOG.warning("%s: comment %.80r is left out: %s", path, comment, problem)
        elif word in ([ORIGIN], [OFFSET]):
            _warn(path, comment, "a shift of the positions")
        elif (meaning := _unapplied_change(comment)) is not None:
            _warn(path, comment, meaning)
    axes = list(dict.fromkeys(axis for comment in all_comments if (axis := named_up(comment)) is not None))
    if len(axes) > 1:
        LOG.warning("%s: comments name different axes that are up: %s", path, ", ".join(axes))


def warn_of_files_beside(path: Path) -> None:
    """Logs a warning about files near a PLY that move its Gaussians.

    They state a shift of the positions (Pix4D, Metashape, DJI Terra), or are networks of a moving scene in a model
    folder (4DGaussians, Deformable 3D Gaussians).
    """
    folder = Path(os.path.abspath(path)).parent  # a relative path may not contain the names of folders
    beside = [folder / name for name in (f"{path.stem}_offset.xyz", "offset.xyz", f"{path.stem}_origin.json")]
    file_names = [file.name for file in beside if file.is_file()]
    survey = folder / "metadata.xml"
    if survey.is_file() and b"<SRSOrigin>" in read_at_most(survey, _SURVEY_BYTES, DatasetError):
        file_names.append(survey.name)
    moving = (
        [folder / name for name in ("deformation.pth", "deform.pth")] if folder.name.startswith("iteration_") else []
    )
    moving += [folder.parents[1] / "deform"] if moving and folder.parent.name == "point_cloud" else []
    if found := [file for file in moving if file.exists()]:
        LOG.warning(
            "%s: %s near it moves the Gaussians in the course of time and is not read: the scene does not move",
            path, found[0].name,
        )  # fmt: skip
    if file_names:
        LOG.warning(
            "%s: %s beside it may have a shift of the positions: it is left out, positions are read as they are in "
            "the file", path, ", ".join(file_names),
        )  # fmt: skip


def warn_of_unused_fields(path: Path, content: object) -> None:
    """Logs a warning with the names of JSON fields that are ignored although they may change the scene.

    Args:
        path: The file.
        content: The parsed JSON object.
    """
    for name, value in content.items() if isinstance(content, dict) else ():
        text = _value_as_text(value)
        if text is None:
            continue
        field = f"{name:.200}: {text}"
        if names_up(field):
            _warn(path, field, "the axis that is up", "field")
        elif (meaning := _unapplied_change(field)) is not None:
            _warn(path, field, meaning, "field")


def _value_as_text(value: object) -> str | None:
    """Returns a metadata value of a JSON file as text that can be searched for numbers.

    The result is None if the value cannot contain numbers.
    """
    if isinstance(value, dict):
        value = [part for pair in value.items() for part in pair]
    if isinstance(value, list):
        numbers = len(value) <= _MAX_NUMBERS and all(isinstance(part, (str, int, float)) for part in value)
        return " ".join(f"{part:.40}" if isinstance(part, str) else repr(part) for part in value) if numbers else None
    return f"{value:.200}" if isinstance(value, str) else repr(value) if isinstance(value, (int, float)) else None


def _warn(path: Path, comment: str, meaning: str, kind: str = "comment") -> None:
    LOG.warning(
        "%s: %s %.80r may be %s: it is left out, values are read as they are in the file",
        path, kind, comment, meaning,
    )  # fmt: skip


def _unapplied_change(comment: str) -> str | None:
    """Searches a PLY comment for a change of the scene, such as a shift, that this package does not apply.

    Returns:
        Description of the change for a warning, such as `a shift of the positions`; None if none is found.
    """
    if comment.startswith("splatwire") or is_metadata(comment):
        return None
    begins = range(0, max(len(comment) - _OVERLAP, 1), _PIECE - _OVERLAP)
    pieces = (comment[begin : begin + _PIECE] for begin in begins)
    return next((meaning for piece in pieces if (meaning := _unapplied_change_in_part(piece)) is not None), None)


def _unapplied_change_in_part(comment: str) -> str | None:
    """Searches one part of a PLY comment for a change of the scene that this package does not apply.

    The caller, `_unapplied_change`, divides long comments into overlapping parts.

    Args:
        comment: The part of the comment.

    Returns:
        Description of the change for a warning, such as `a shift of the positions`; None if none is found.
    """
    words = [word.lower() for word in _WORDS.findall(_TOOL.sub("", comment))]
    numbers = [_number(word) for word in words]
    if _PROGRAM.match(comment) and sum(number is not None for number in numbers) < _VECTOR:
        return None
    for pattern, meaning in _OTHER_VALUES:
        if pattern.search(comment):
            return meaning
    if _SYSTEMS.search(comment):
        return "the coordinate reference system of the positions"
    if values := _numbers_after(words, numbers, _SHIFTS):
        moves = values == [1.0] and _ALONG_AXIS.search(comment)  # else 1 may say that positions were normalised
        return None if _is_identity(values) and not moves else "a shift of the positions"
    if pose := _POSES.search(comment):
        values = [float(word) for word in re.split(r"[^-+.\de]+", pose["values"].lower()) if word]
        return None if _is_identity(values) else "a shift of the positions"
    if _POINTS.search(comment) and any(numbers):
        return "a shift of the positions"
    if values := _numbers_after(words, numbers, _SCALES):
        return None if set(values) == {1.0} else "a scale of the positions"
    if any(word in _UNITS for word in words):
        index = next(index for index, word in enumerate(words) if word in _UNITS)
        named = [word for word in words[index + 1 :] if word not in ("is", "in", "per", "unit", "units")]
        return None if not named or set(named) <= _METRES else "the unit of the positions"
    if _LENGTHS.search(comment):
        return "the unit of the positions"
    if turn := _TURNS.search(comment):
        values = [value for word in re.split(r"[^-+.\d]+", turn[0]) if (value := _number(word)) is not None]
        if not values or (any(values) and not (len(values) > _VECTOR and _is_identity(values))):
            return "a rotation of the positions"
    if names_up(comment) or not _AXES.search(comment) or _OWN_AXES.search(comment):
        return None
    return "a system of axes"


def _number(word: str) -> float | None:
    try:
        return float(word.replace(",", "").replace("'", ""))
    except ValueError:
        return None


def _is_identity(values: list[float]) -> bool:
    """Returns True if the transform that the numbers in a comment describe leaves all positions unchanged.

    The count of the numbers determines their meaning:

    * 1 number is a scale or a shift. The result is True for 0 and 1.
    * 3 numbers are a shift. The result is True for zeros.
    * 9, 12 or 16 numbers are a matrix, row by row. The result is True for the identity.
    * Any other count is a mix of rotation, shift and scale. The result is True if all numbers are 0 or 1, and at most
      two of them are 1.
    """
    if len(values) in (1, _VECTOR):
        return not any(values) or values == [1.0]
    if len(values) in _MATRICES:
        rows, columns = _MATRICES[len(values)]
        return values == [float(row == column) for row in range(rows) for column in range(columns)]
    return set(values) <= {0.0, 1.0} and values.count(1) <= 2


def _numbers_after(words: list[str], numbers: list[float | None], keywords: frozenset[str]) -> list[float]:
    """Returns all numbers in a comment after the first keyword that announces a number, such as `shift`.

    A keyword counts only if a number follows within a few words.

    Args:
        words: Words and numbers of the comment, in lower case.
        numbers: Value of each word; None for words that are no number.
        keywords: Words that announce a number, in lower case.

    Returns:
        The numbers; an empty list without such a keyword.
    """
    for index, word in enumerate(words):
        if word not in keywords:
            continue
        numbers_after = [number for number in numbers[index + 1 :] if number is not None]
        if any(number is not None for number in numbers[index + 1 : index + 2 + _MAX_BETWEEN]):
            return numbers_after
    return []
