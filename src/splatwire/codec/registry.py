"""The schemas that there are: a scene's own, and those that streams name."""

from typing import Any

from splatwire.codec.schema import Schema
from splatwire.errors import InvalidValueError, UnknownNameError

_SCHEMAS: dict[str, Schema] = {}


def register_schema(schema: Schema) -> None:
    """Makes a kind of element known to encoder and decoder; its limits belong into `splatwire.packets.limits`.

    Raises:
        InvalidValueError: If another one has its name.
    """
    if _SCHEMAS.setdefault(schema.name, schema) is not schema:
        raise InvalidValueError(f"a schema '{schema.name}' is registered already")


def schema_named(name: str) -> Schema:
    """The schema that a manifest names.

    Raises:
        UnknownNameError: If nobody registered it.
    """
    if name not in _SCHEMAS:
        raise UnknownNameError("schema", name, _SCHEMAS)
    return _SCHEMAS[name]


def schema_of(scene: Any) -> Schema:
    """The schema that codes a scene.

    Raises:
        InvalidValueError: If none does.
    """
    found = next((schema for schema in _SCHEMAS.values() if schema.codes(scene)), None)
    if found is None:
        raise InvalidValueError(f"expected a scene (`open_scene` reads one from a file), not {type(scene).__name__}")
    return found
