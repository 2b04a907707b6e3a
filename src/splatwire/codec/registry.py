"""Registry of codecs (schemas), by name and by type of scene.

Other packages can add codecs with `register_schema` (docs/your-own-codec.md).
"""
# The registry is `splatwire.bitstream.limits.SCHEMAS`. A package announces a schema under the entry point group
# `splatwire.schemas` (`splatwire.plugins`).

import importlib
import re
from collections.abc import Iterable
from typing import Any

from splatwire.arguments import checked
from splatwire.bitstream.limits import FORMAT_VERSION, SCHEMAS, StreamSchema
from splatwire.codec.schema import Schema
from splatwire.errors import InvalidValueError, UnknownNameError, how_to_install

_NAME = re.compile("[a-z][a-z0-9_]{0,31}", re.ASCII)
_CALLED = ("can_encode", "prepare", "open_decoder", "update_digest", "can_repack", "remap_sections")
_OWN = "splatwire."


@checked
def register_schema(schema: StreamSchema) -> Schema:
    """Registers a codec (schema) for use by the encoder, the decoder and all stream readers.

    Args:
        schema: The complete codec, a `splatwire.codec.schema.Schema`.

    Returns:
        The codec.

    Raises:
        InvalidValueError: If an attribute of the codec is missing or invalid, or its name is taken.
    """
    if not isinstance(schema, Schema):
        raise InvalidValueError(f"expected a complete Schema (splatwire.codec.schema), not {type(schema).__name__}")
    if wrong := _problem(schema):
        raise InvalidValueError(f"schema {schema.name!r:.40} is not complete: {wrong}")
    SCHEMAS.register(schema.name, schema, f"{schema.prepare.__module__}.{schema.name}")
    return schema


@checked
def schema_named(name: str) -> Schema:
    """Returns the codec (schema) with a given name, as manifests contain it.

    Raises:
        UnknownNameError: If the name is unknown.
        InvalidValueError: If the package that provides it cannot be loaded.
    """
    entry = SCHEMAS[name]
    if not isinstance(entry, Schema) and not entry.codec_path:
        coded = (
            name_of_codec
            for name_of_codec, schema in SCHEMAS.registered().items()
            if schema.codec_path or isinstance(schema, Schema)
        )
        raise UnknownNameError("schema", name, coded)
    return _load_codec(entry)


@checked
def schema_of(scene: Any) -> Schema:
    """Returns the codec (schema) that encodes a scene.

    Raises:
        InvalidValueError: If no schema applies, or several packages have one for the same type.
    """
    # If several schemas fit, the one for the most derived class of the scene is returned.
    best = _most_specific(scene, SCHEMAS.registered().values())
    if best is None or best.scene_type is not type(scene):  # a package may provide a schema for exactly this type
        best = _most_specific(scene, SCHEMAS.all().values())
    if best is None:
        raise InvalidValueError(f"expected a scene (`open_scene` reads one from a file), not {type(scene).__name__}")
    return best


def _most_specific(scene: Any, schemas: Iterable[StreamSchema]) -> Schema | None:
    kinds = type(scene).__mro__
    type_names = {f"{kind.__module__}:{kind.__qualname__}" for kind in kinds}
    fitting: dict[int, list[Schema]] = {}
    for stream_schema in schemas:
        if not isinstance(stream_schema, Schema) and stream_schema.scene_path not in type_names:
            continue
        schema = _load_codec(stream_schema)
        if isinstance(scene, schema.scene_type) and schema.can_encode(scene):
            distance = kinds.index(schema.scene_type) if schema.scene_type in kinds else len(kinds)
            fitting.setdefault(distance, []).append(schema)
    best = fitting[min(fitting)] if fitting else []
    best = [schema for schema in best if schema.prepare.__module__.startswith(_OWN)] or best
    if len(best) > 1:
        names = " and ".join(f"'{schema.name}'{SCHEMAS.provider_suffix(schema.name)}" for schema in best)
        raise InvalidValueError(f"schemas {names} both code {type(scene).__name__}: uninstall the package of one")
    return best[0] if best else None


def _load_codec(stream_schema: StreamSchema) -> Schema:
    """Imports the codec (encoder and decoder) of a kind of stream.

    Args:
        stream_schema: Properties of the streams, with the module and name of the codec. A complete codec (`Schema`) is
            returned unchanged.
    """
    # Stream readers register only the properties of streams, to avoid importing the codec.
    if isinstance(stream_schema, Schema):
        return stream_schema
    module, _, name = stream_schema.codec_path.partition(":")
    try:
        schema: Schema = getattr(importlib.import_module(module), name)
    except ModuleNotFoundError as error:
        if how := how_to_install(error.name):
            error.add_note(how)
        raise
    return schema


def _problem(schema: Schema) -> str:
    """Returns a message about the first missing or invalid attribute of a codec, or an empty text."""
    if not isinstance(schema.name, str) or not _NAME.fullmatch(schema.name):
        return "its name must be 1 to 32 lower-case letters, digits and underscores"
    if type(schema.format_version) is not int or not 2 <= schema.format_version <= FORMAT_VERSION:
        return f"format_version must be 2 to {FORMAT_VERSION}, not {schema.format_version!r}"
    if not isinstance(schema.elements, str) or not schema.elements:
        return "elements must be a word for its elements"
    names = schema.sections
    if not isinstance(names, tuple) or not names or not all(isinstance(name, str) and name for name in names):
        return "sections must be a tuple of names, one or more"
    if type(schema.elements_per_byte) is not int or schema.elements_per_byte < 1:
        return f"elements_per_byte must be 1 or more, not {schema.elements_per_byte!r}"
    if not isinstance(schema.scene_type, type):
        return f"scene_type must be a class, not {schema.scene_type!r:.40}"
    if not all(isinstance(kind, type) for kind in schema.provides):
        return "provides must hold classes"
    called = [*_CALLED, *(["prepare_repack"] if schema.prepare_repack is not None else [])]
    wrong = [name for name in called if not callable(getattr(schema, name))]
    return f"{', '.join(wrong)} cannot be called" if wrong else ""
