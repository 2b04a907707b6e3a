"""The manifest: description of a stream that is needed before decoding starts."""

import hashlib
import json
import re
from dataclasses import asdict, dataclass, fields
from typing import Any

from splatwire.arguments import check_fields, checked
from splatwire.bitstream.limits import (
    FORMAT_VERSION,
    FREE_ELEMENTS,
    MANIFEST_FORMAT,
    MAX_ELEMENTS,
    MAX_FEATURE_DIM,
    MAX_MANIFEST_BYTES,
    MAX_OFFSETS,
    MAX_SIDE_INFO_BYTES,
    MAX_SPANS,
    MAX_STREAM_LANES,
    MAX_WRITER_LENGTH,
    SCHEMAS,
    UNNAMED_SCHEMA,
    StreamSchema,
)
from splatwire.bitstream.packet_id import PARTS
from splatwire.bitstream.packetization import Packetization
from splatwire.bitstream.plan import PacketPlan
from splatwire.bitstream.tiers import TierCounts, check_gop_tiers
from splatwire.errors import BitstreamError, InvalidValueError, UnknownNameError, UnsupportedVersionError
from splatwire.lazy_names import renamed_attributes

_LAYOUT_FIELDS = ("feature_dim", "num_offsets", "feature_groups")


@dataclass(frozen=True, kw_only=True)
class Manifest:
    """Description of a stream, which is needed before decoding.

    Attributes:
        packetization: Parameters of the division into packets.
        num_elements: Number of elements of the stream, N: anchors or Gaussians; in a sequence, keyframe Gaussians and,
            for each group of pictures, tracks with motion.
        num_packets: Number of packets of the complete stream.
        stream_id: Id in every packet of the stream, 32 bits.
        side_info_bytes: Size of the side information, bytes.
        side_info_digest: SHA-256 of the side information, hexadecimal.
        symbols_digest: SHA-256 of all integers that a decoder of the complete stream obtains, hexadecimal
            (`CodedPackets.decoded_rows`; not always the entropy-coded symbols).
        writer: Program that wrote the stream.
        schema_name: Name of the schema, a key of `splatwire.bitstream.limits.SCHEMAS`.
        feature_dim: Number of channels of the anchor feature, F; 0 if the side information contains this number.
        num_offsets: Number of offsets per anchor, K; 0 if the side information contains this number.
        feature_groups: Sizes of the feature's channel groups, in coding order.
        tiers: Element counts of the importance tiers; empty for a single tier.

    Raises:
        InvalidValueError: If a field is out of range or contradicts another.
    """

    packetization: Packetization
    num_elements: int
    num_packets: int
    stream_id: int
    side_info_bytes: int
    side_info_digest: str
    symbols_digest: str
    writer: str
    schema_name: str = UNNAMED_SCHEMA
    feature_dim: int = 0
    num_offsets: int = 0
    feature_groups: tuple[int, ...] = ()
    tiers: tuple[TierCounts, ...] = ()

    def __post_init__(self) -> None:
        check_fields(self)
        if SCHEMAS.find(self.schema_name) is None:
            raise UnknownNameError("schema of a stream", self.schema_name, SCHEMAS.known_names())
        lower, upper = (1, MAX_FEATURE_DIM) if self.schema.layout else (0, 0)
        for name, low, high in (
            ("num_elements", 0, MAX_ELEMENTS),
            ("feature_dim", lower, upper),
            ("num_offsets", lower, min(upper, MAX_OFFSETS)),
            ("num_packets", 0, len(PARTS) * MAX_STREAM_LANES),
            ("stream_id", 0, (1 << 32) - 1),
            ("side_info_bytes", 0, MAX_SIDE_INFO_BYTES),
        ):
            _check_integer(name, getattr(self, name), low, high)
        if self.num_elements > FREE_ELEMENTS + self.schema.elements_per_byte * self.side_info_bytes:
            raise InvalidValueError(f"{self.side_info_bytes} bytes cannot place {self.num_elements} elements")
        for size in self.feature_groups:
            _check_integer("a size in feature_groups", size, 1, self.feature_dim)
        if sum(self.feature_groups) != self.feature_dim:
            raise InvalidValueError(f"feature_groups {self.feature_groups} do not add up to {self.feature_dim}")
        for name in ("side_info_digest", "symbols_digest"):
            if not _SHA256.fullmatch(getattr(self, name)):
                raise InvalidValueError(f"{name} is not a SHA-256 in lower-case hexadecimal")
        if not _WRITER.fullmatch(self.writer):
            raise InvalidValueError(f"writer must be at most {MAX_WRITER_LENGTH} printable ASCII characters")
        check_gop_tiers(self.tiers, timed=self.schema.timed)
        self._check_num_packets()

    __getattr__ = renamed_attributes("Manifest", {"codec": "schema_name"})

    @property
    def schema(self) -> StreamSchema:
        """Schema of the stream's elements."""
        return SCHEMAS[self.schema_name]

    @property
    def format_version(self) -> int:
        """Version of the stream format that a reader must support."""
        return self.schema.format_version

    @property
    def elements(self) -> str:
        """Plural name of the elements, for messages."""
        return self.schema.elements

    @property
    def plan(self) -> PacketPlan:
        """Packet plan: the mapping between elements and packets."""
        groups = len(self.feature_groups) if self.packetization.separated else 0
        return PacketPlan(self.packetization, self.num_elements, self.tiers, groups)

    def _check_num_packets(self) -> None:
        """Checks that the number of packets is possible for the number of elements.

        A manifest may be forged, so the check uses little memory, whatever the numbers are.
        """
        num_parts, num_blocks = len(self.plan.parts), self.plan.num_blocks
        lanes = num_parts * sum(min(span.num_elements, span.num_blocks * span.lanes) for span in self.plan.spans)
        max_packets = self.num_elements if self.packetization.hashed else lanes
        if not num_blocks * num_parts <= self.num_packets <= max_packets or self.num_packets % num_parts:
            raise InvalidValueError(
                f"{self.num_packets} packets cannot carry {self.num_elements} elements in {num_blocks} blocks "
                f"of {self.packetization.lanes} lanes with {self.packetization.packaging} packaging"
            )


_SHA256 = re.compile("[0-9a-f]{64}", re.ASCII)
_WRITER = re.compile(f"[ -~]{{0,{MAX_WRITER_LENGTH}}}", re.ASCII)
_TYPE_NAMES = {int: "an integer", str: "text", list: "a list", dict: "an object"}
_KEYS = {"num_elements": "num_anchors", "schema_name": "codec"}
"""Keys in JSON that differ from the name of the field. `num_anchors` dates from version 1, which had anchors only."""
_JSON_TYPES: dict[str, type] = {
    **{_KEYS.get(f.name, f.name): int for f in fields(Manifest)},
    **dict.fromkeys(("stream_id", "side_info_digest", "symbols_digest", "writer", "codec"), str),
    "format_version": int,
    "packetization": dict,
    "feature_groups": list,
    "tiers": list,
}
_PACKETIZATION_TYPES: dict[str, type] = {f.name: type(f.default) for f in fields(Packetization)}


@checked
def manifest_to_bytes(manifest: Manifest) -> bytes:
    """Serialises a manifest as compact JSON with sorted keys; one of them is a digest of all other fields."""
    content = _content(manifest)
    return _dump({**content, "digest": _digest(content)})


@checked
def manifest_from_bytes(data: bytes, name: str = "manifest.json") -> Manifest:
    """Parses a manifest and validates its fields.

    Args:
        data: JSON in UTF-8.
        name: Source of the bytes, for error messages.

    Raises:
        UnsupportedVersionError: If a newer release wrote the manifest.
        BitstreamError: If the bytes are damaged, inconsistent, or not a manifest.
    """
    content = _parse_json(data, name)
    if content.get("schema") != MANIFEST_FORMAT:
        raise BitstreamError(f"{name} is not a manifest of schema '{MANIFEST_FORMAT}'")
    version = content.get("format_version")
    if type(version) is int and version > FORMAT_VERSION:
        problem = f"{name} has format version {version!r:.20}, this release reads up to {FORMAT_VERSION}"
        raise UnsupportedVersionError(problem)
    if type(version) is not int or version < 1:
        raise BitstreamError(f"{name}: format_version is {version!r:.20}, not a number from 1 to {FORMAT_VERSION}")
    digest = content.pop("digest", None)
    content.pop("schema")
    _check_fields(content, _expected_fields(version, "tiers" in content), name)
    types = dict(_PACKETIZATION_TYPES)
    if content["packetization"].get("grouping") != "hashed":
        del types["packet_bytes"]
    _check_fields(content["packetization"], types, f"{name}: packetization")
    if not all(type(size) is int for size in content.get("feature_groups", [])):
        raise BitstreamError(f"{name}: feature_groups does not hold integers only")
    schema = _schema(content.get("codec", UNNAMED_SCHEMA), name)
    tiers, max_tiers = content.get("tiers", []), schema.max_tiers if schema else MAX_SPANS
    if ("tiers" in content and not 2 <= len(tiers) <= max_tiers) or not all(_is_pair(tier) for tier in tiers):
        raise BitstreamError(f"{name}: tiers does not hold pairs of integers only, 2 to {max_tiers} of them")
    # The content is flat from this line on: a digest of arbitrarily nested lists could exhaust the stack.
    if digest != _digest({**content, "schema": MANIFEST_FORMAT}):
        raise BitstreamError(f"{name} is damaged: its digest does not match its content")
    if content.pop("format_version") != (schema.format_version if schema else None):
        raise BitstreamError(f"{name}: format_version {version} has no codec {ascii(content.get('codec'))[:40]}")
    try:
        named = {_KEYS.get(name, name): name for name in Manifest.__dataclass_fields__}
        return Manifest(
            **{
                **{named[key]: value for key, value in content.items()},
                "packetization": Packetization(**content["packetization"]),
                "feature_groups": tuple(content.get("feature_groups", ())),
                "stream_id": _stream_id(content["stream_id"]),
                "tiers": tuple(TierCounts(*tier) for tier in tiers),
            }
        )
    except (InvalidValueError, UnknownNameError) as error:
        raise BitstreamError(f"{name}: {error}") from error


def _schema(schema_name: str, name: str) -> StreamSchema | None:
    """Returns the schema with a given name, or None if unknown.

    Args:
        schema_name: Name of the schema.
        name: Source of the manifest, for error messages.

    Raises:
        BitstreamError: If the package that provides it cannot be used.
    """
    try:
        return SCHEMAS.find(schema_name)
    except InvalidValueError as error:
        raise BitstreamError(f"{name}: {error}") from error


def packetization_to_json(packetization: Packetization) -> bytes:
    """Serialises packetization parameters as canonical JSON."""
    return _dump(_packetization_content(packetization))


def _packetization_content(packetization: Packetization) -> dict[str, Any]:
    """Returns the JSON fields of packetization parameters."""
    content = asdict(packetization)
    # Manifests without hashed grouping stay as they were before it was introduced.
    if not packetization.hashed:
        del content["packet_bytes"]
    return content


def _expected_fields(version: object, tiers: bool) -> dict[str, type]:
    """Returns names and types of the JSON fields that a manifest must have.

    Args:
        version: Version of the stream format.
        tiers: True if the manifest has the field `tiers`.
    """
    absent = {"codec"} if version == 1 else set(_LAYOUT_FIELDS)
    return {k: kind for k, kind in _JSON_TYPES.items() if k not in absent and (tiers or k != "tiers")}


def _content(manifest: Manifest) -> dict[str, Any]:
    content = {
        **{_KEYS.get(name, name): value for name, value in asdict(manifest).items()},
        "format_version": manifest.format_version,
        "packetization": _packetization_content(manifest.packetization),
        "schema": MANIFEST_FORMAT,
        "stream_id": f"{manifest.stream_id:08x}",
        "tiers": [[tier.num_elements, tier.lanes] for tier in manifest.tiers],
    }
    expected = _expected_fields(manifest.format_version, bool(manifest.tiers))
    return {key: value for key, value in content.items() if key in expected or key == "schema"}


def _is_pair(value: object) -> bool:
    return type(value) is list and len(value) == 2 and all(type(number) is int for number in value)


def _dump(content: dict[str, Any]) -> bytes:
    return json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def _digest(content: dict[str, Any]) -> str:
    return hashlib.sha256(_dump(content)).hexdigest()[:16]


def _parse_json(data: bytes, name: str) -> dict[str, Any]:
    """Parses the JSON object of a manifest; rejects duplicate keys, fractional numbers, NaN and infinity."""
    if len(data) > MAX_MANIFEST_BYTES:
        raise BitstreamError(f"{name} is not a manifest: it has more than {MAX_MANIFEST_BYTES} bytes")
    try:
        content = json.loads(
            bytes(data).decode("utf-8"),
            object_pairs_hook=_unique,
            parse_float=_refuse,
            parse_constant=_refuse,
        )
    except (ValueError, RecursionError) as error:
        raise BitstreamError(f"{name} is not valid JSON: {error}") from error
    if not isinstance(content, dict):
        raise BitstreamError(f"{name} is not a JSON object")
    return content


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) != len(pairs):
        raise ValueError("a key appears twice")
    return content


def _refuse(text: str) -> None:
    raise ValueError(f"{text} is not an integer")


def _check_fields(content: dict[str, Any], types: dict[str, type], name: str) -> None:
    """Checks that a JSON object has exactly the given fields, and that their values have the given types.

    Args:
        content: The JSON object.
        types: Python type of each field's value, by name of the field.
        name: Source of the JSON object, for error messages.

    Raises:
        BitstreamError: If a field is missing or unknown, or has a value of another type.
    """
    if missing := sorted(set(types) - set(content)):
        raise BitstreamError(f"{name} lacks {', '.join(missing)}")
    if unknown := sorted(set(content) - set(types)):
        raise BitstreamError(f"{name} has unknown fields: {', '.join(map(ascii, unknown))[:200]}")
    for key, kind in types.items():
        if type(content[key]) is not kind:  # isinstance would take true for the integer 1
            raise BitstreamError(f"{name}: {key} is not {_TYPE_NAMES[kind]}")


def _stream_id(text: str) -> int:
    if not re.fullmatch("[0-9a-f]{8}", text, re.ASCII):
        raise InvalidValueError("stream_id is not 8 lower-case hexadecimal digits")
    return int(text, 16)


def _check_integer(name: str, value: object, low: int, high: int) -> None:
    if type(value) is not int or not low <= value <= high:
        raise InvalidValueError(f"{name} must be an integer from {low} to {high}, not {value!r:.60}")
