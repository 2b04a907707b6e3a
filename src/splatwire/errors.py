"""Exceptions of splatwire.

```
SplatwireError
├─ BitstreamError            the bytes do not conform to the stream format
│   ├─ UnsupportedVersionError
│   ├─ TruncatedStreamError
│   ├─ CorruptPacketError    (carries the packet's name)
│   │   └─ ForeignPacketError    intact, but of another stream
│   └─ MissingSideInfoError
├─ DesyncError               decoded values differ from the encoded ones
├─ DatasetError              a folder or file is not a valid dataset or model
│  └─ NoViewsError           a split of a dataset has no views
├─ BackendUnavailableError   (carries how to install it)
├─ DivergedError             a training run has diverged (carries the iteration)
├─ InvalidValueError         an argument is invalid (also a ValueError)
│  └─ UnknownHostError       a host name cannot be resolved
└─ UnknownNameError          (carries the known names; also a ValueError)
```

Lost packets raise no exception; `splatwire.types.LossMask` describes what was lost.
"""

import operator
from collections.abc import Iterable

MALFORMED = (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError)
"""Exceptions that Python raises when code parses plain data (JSON, tensors of a file) of an unexpected form."""
ACCESS_ADVICE = " (`ls -ld` shows its owner and mode, `chmod` and `chown` change them)"
"""End of messages about files and folders that this user may not access."""


def shown(value: object) -> str:
    """Describes a value for an error message.

    The description is the value itself for a number or a text, dtype and shape for an array, and the name of the type
    for any other value.
    """
    # The `repr` of other objects is not called, because it may be long or raise.
    if isinstance(value, int) and value.bit_length() > _MANY_BITS:
        return f"an integer of {value.bit_length()} bits"
    if value is None or isinstance(value, (bool, int, float, complex, str, bytes)):
        return f"{value!r:.60}"
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        return f"{str(value.dtype).removeprefix('torch.')} {tuple(value.shape)}"
    return type(value).__name__


_MANY_BITS = 200
"""Integers with more bits than this are shown as their length; Python refuses to print very long ones."""


def check_kind(value: object, kind: type, reader: str, name: str = "") -> None:
    """Checks that an argument is an object of a given type, such as a scene. The path of its file is not accepted.

    Args:
        value: The argument.
        kind: The expected type.
        reader: Name of the function that returns such an object, or an expression such as `open_scene(...).splats`, for
            the message.
        name: Name of the argument, for the message.

    Raises:
        InvalidValueError: If the argument has another type.
    """
    if not isinstance(value, kind):
        actual = type(value).__name__
        if isinstance(value, tuple) and value and isinstance(value[0], kind):
            actual = f"a pair: take its first item, as in `first, report = {reader}(path)`"
        where = f"{name}: " if name else ""
        how = "is one" if "(" in reader else "returns one" if reader == "decode_stream" else "reads one from a file"
        raise InvalidValueError(f"{where}expected {kind.__name__} (`{reader}` {how}), not {actual}")


def whole_number(value: object, name: str, least: int = 0, most: int | None = None) -> int:
    """Returns an argument as int; NumPy integers are accepted.

    Args:
        value: The argument.
        name: Name of the argument, for the message.
        least: Minimum value.
        most: Maximum value; None for no maximum.

    Raises:
        InvalidValueError: If the argument is not an integer, or out of range.
    """
    try:
        number = None if isinstance(value, bool) else operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        number = None
    if number is None or number < least:
        raise InvalidValueError(f"{name} must be a whole number of {least} or more, not {shown(value)}")
    if most is not None and number > most:
        raise InvalidValueError(f"{name} must be a whole number of at most {most}, not {shown(value)}")
    return number


def check_progress(progress: object) -> None:
    """Checks that a progress argument is a function or None.

    Raises:
        InvalidValueError: If the argument is anything else, such as True.
    """
    if progress is not None and not callable(progress):
        raise InvalidValueError(f"progress must be a function that is called with the progress, not {shown(progress)}")


MAX_TEXT = 800
"""Maximum characters of a message. Messages may quote untrusted files, and longer ones are cut in the middle."""


class SplatwireError(Exception):
    """Base class of all exceptions that splatwire raises on purpose."""

    def __str__(self) -> str:
        text = super().__str__()
        return text if len(text) <= MAX_TEXT else f"{text[: MAX_TEXT // 2]} … {text[-MAX_TEXT // 2 :]}"


class BitstreamError(SplatwireError):
    """Bytes do not conform to the stream format."""


class UnsupportedVersionError(BitstreamError):
    """The bytes were written by a format version that this release does not read."""


class TruncatedStreamError(BitstreamError):
    """The bytes end before the end required by the format."""


class CorruptPacketError(BitstreamError):
    """A packet fails its checksum or contradicts its header.

    Args:
        packet: Name of the packet, such as `pak_lane3_s0.pak`.
        reason: The error.
    """

    def __init__(self, packet: str, reason: str) -> None:
        super().__init__(f"packet {packet} is corrupt: {reason}")
        self.packet = packet
        self.reason = reason


class ForeignPacketError(CorruptPacketError):
    """A packet is intact, but belongs to another stream."""


class MissingSideInfoError(BitstreamError):
    """The side information is missing or incomplete, so that no packet can be decoded."""


class DesyncError(SplatwireError):
    """All data arrived intact, but the digest of the decoded values differs from the digest of the encoded values."""


class DatasetError(SplatwireError):
    """A folder or file is missing, damaged, or not a dataset or model of the expected kind."""


class NoViewsError(DatasetError):
    """The training or test split of a dataset has no views."""


class BackendUnavailableError(SplatwireError):
    """An optional backend is not installed or cannot run here.

    Args:
        name: The backend.
        how: Instructions to install or enable it.
    """

    def __init__(self, name: str, how: str) -> None:
        super().__init__(f"backend '{name}' is not available: {how}")
        self.name = name


class DivergedError(SplatwireError):
    """A training run has diverged: its loss or state is not finite, or every anchor has become transparent.

    Args:
        iteration: Iteration at which this was detected.
        reason: The reason.
    """

    def __init__(self, iteration: int, reason: str = "the loss is not finite") -> None:
        super().__init__(
            f"training diverged in iteration {iteration}: {reason}; go on from an earlier checkpoint, "
            "or check the poses and the scale of the scene"
        )
        self.iteration = iteration


class InvalidValueError(SplatwireError, ValueError):
    """An argument is invalid, for example out of range or of the wrong type."""


class UnknownHostError(InvalidValueError):
    """A host name cannot be resolved (DNS); a later attempt may succeed."""


def _quoted(name: object) -> str:
    return f"'{name}'" if isinstance(name, str) else shown(name)


class UnknownNameError(SplatwireError, ValueError):
    """A name is not registered.

    Args:
        kind: Kind of the entry (`concealer`, `loss model`).
        name: The unknown name.
        known: The registered names.
    """

    def __init__(self, kind: str, name: str, known: Iterable[str]) -> None:
        super().__init__(f"unknown {kind} {_quoted(name)}: known are {', '.join(sorted(known))}")
        self.kind = kind
        self.name = name


EXTRAS = {
    "scenes": (
        "scipy",
        "numba",
        "llvmlite",
        "threadpoolctl",
        "safetensors",
        "jaxtyping",
        "rich",
        "PIL",
        "zstandard",
    ),
    "neural": ("torch",),
    "report": ("matplotlib", "jinja2"),
    "relay": ("raptorq", "aioquic", "cryptography", "prometheus_client", "jwt"),
    "moq": ("moq",),
    "tables": ("pyarrow",),
    "usd": ("pxr",),
    "clips": ("fourdgs", "splats4d"),
}  # fmt: skip
"""Modules of each extra of the package. Without extras, splatwire can transport streams but not decode them."""


def how_to_install(module: str | None) -> str | None:
    """Returns a message with the command that installs an optional dependency; None for any other module."""
    for extra, modules in EXTRAS.items():
        if (module or "").split(".")[0] in modules:
            return f"this needs {module}, which is not installed: pip install 'splatwire[{extra}]'"
    return None
