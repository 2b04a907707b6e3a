"""Every error that splatwire raises on purpose.

```
SplatwireError
├─ BitstreamError            the bytes are not what the format promises
│   ├─ UnsupportedVersionError
│   ├─ TruncatedStreamError
│   ├─ CorruptPacketError    (carries the packet's name)
│   │   └─ ForeignPacketError    intact, but of another stream
│   └─ MissingSideInfoError
├─ DesyncError               coding parameters differ between the two ends
├─ DatasetError              a folder or file is not the dataset or model it should be
├─ BackendUnavailableError   (carries how to install it)
├─ DivergedError             a training run's loss is not finite any more (carries the iteration)
├─ InvalidValueError         a parameter is out of range (also a ValueError)
└─ UnknownNameError          (carries the known names; also a ValueError)
```

A lost packet is not an error: it is data (`splatwire.scene.Erasures`).
"""

from collections.abc import Iterable

MALFORMED = (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError)
"""What Python raises where plain data (JSON, tensors of a file) are not what the code that takes them apart expects."""


def check_kind(value: object, kind: type, reader: str) -> None:
    """Checks that a public function was given its noun, and not the path of a file that holds one.

    Raises:
        InvalidValueError: If it was not; the message names what reads a file.
    """
    if not isinstance(value, kind):
        found = type(value).__name__
        if isinstance(value, tuple) and value and isinstance(value[0], kind):
            found = f"a pair: take its first item, as in `{kind.__name__.lower()}, report = {reader}(path)`"
        raise InvalidValueError(f"expected {kind.__name__} (`{reader}` reads one from a file), not {found}")


MOST_TEXT = 800
"""Characters of a message: what somebody's file says is not repeated at whatever length."""


class SplatwireError(Exception):
    """Base of all errors that splatwire raises on purpose."""

    def __str__(self) -> str:
        text = super().__str__()
        return text if len(text) <= MOST_TEXT else f"{text[: MOST_TEXT // 2]} … {text[-MOST_TEXT // 2 :]}"


class BitstreamError(SplatwireError):
    """The bytes are not what the format promises."""


class UnsupportedVersionError(BitstreamError):
    """The bytes were written by a format version that this release does not read."""


class TruncatedStreamError(BitstreamError):
    """The bytes end before the format says they should."""


class CorruptPacketError(BitstreamError):
    """A packet fails its checksum or contradicts its header.

    Args:
        packet: The packet's name, as a person would look it up (`pak_lane3_s0.pak`).
        reason: What was wrong with it.
    """

    def __init__(self, packet: str, reason: str) -> None:
        super().__init__(f"packet {packet} is corrupt: {reason}")
        self.packet = packet
        self.reason = reason


class ForeignPacketError(CorruptPacketError):
    """A packet is intact, but belongs to another stream."""


class MissingSideInfoError(BitstreamError):
    """The stream has no (complete) side information, so no packet of it can be decoded."""


class DesyncError(SplatwireError):
    """Encoder and decoder derived different coding parameters (digest mismatch)."""


class DatasetError(SplatwireError):
    """A folder or file is not the dataset or model that it should be."""


class BackendUnavailableError(SplatwireError):
    """An optional backend is not installed or cannot run here.

    Args:
        name: The backend.
        how: How to get it.
    """

    def __init__(self, name: str, how: str) -> None:
        super().__init__(f"backend '{name}' is not available: {how}")
        self.name = name


class DivergedError(SplatwireError):
    """A training run's loss is not finite any more, or nothing of its scene is left.

    Args:
        iteration: The iteration that found out.
        what: What was found.
    """

    def __init__(self, iteration: int, what: str = "the loss is not finite") -> None:
        super().__init__(
            f"training diverged in iteration {iteration}: {what}; go on from an earlier checkpoint, "
            "or check the poses and the scale of the scene"
        )
        self.iteration = iteration


class InvalidValueError(SplatwireError, ValueError):
    """A parameter is outside of the range that makes sense; the message says which and what the range is."""


class UnknownNameError(SplatwireError, ValueError):
    """A name was asked for that no registry knows.

    Args:
        kind: What sort of thing was looked up (`concealer`, `loss model`).
        name: The name that was not found.
        known: The names that exist.
    """

    def __init__(self, kind: str, name: str, known: Iterable[str]) -> None:
        super().__init__(f"unknown {kind} '{name}': known are {', '.join(sorted(known))}")
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
    "relay": ("raptorq", "aioquic", "cryptography"),
    "moq": ("moq",),
    "tables": ("pyarrow",),
}  # fmt: skip
"""The modules that each extra of the package brings; without any it carries streams, and cannot look into them."""


def how_to_install(module: str | None) -> str | None:
    """What to do about a module that is not installed; None where it is of no extra."""
    for extra, modules in EXTRAS.items():
        if (module or "").split(".")[0] in modules:
            return f"this needs {module}, which is not installed: pip install 'splatwire[{extra}]'"
    return None
