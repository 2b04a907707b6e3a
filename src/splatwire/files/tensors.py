"""Reader of `torch.save` files: checks for plain tensors and returns numpy arrays, without torch or unpickling."""

import re
import struct
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from pickletools import genops
from typing import Any, BinaryIO, cast

import numpy as np

from splatwire.errors import SplatwireError
from splatwire.files.archive import open_archive
from splatwire.files.read_limited import open_regular

MAX_TENSOR_FILE_BYTES = 256 << 20
_MAX_DESCRIPTION_BYTES = 1 << 20
_OLD_DESCRIPTIONS = 5
"""Number of consecutive pickles at the start of a file written before PyTorch 1.6; such files are not ZIP archives."""
_PLAIN = re.compile(r"collections OrderedDict|torch\._utils _rebuild_(tensor_v2|parameter)|torch \w{1,20}Storage")
"""Names (globals) that may occur in the pickle of plain tensors. The mode `weights_only` of PyTorch also allows byte
arrays and sets of any size."""


def check_tensor_file(path: Path, error: type[SplatwireError], limit: int = MAX_TENSOR_FILE_BYTES) -> None:
    """Checks that a file is safe for `torch.load` with `weights_only`.

    The file must be uncompressed, so that it is not larger in memory than on disk.

    Args:
        path: The file.
        error: Exception class to raise for an unsafe or damaged file.
        limit: Maximum size of the file, bytes.

    Raises:
        SplatwireError: An exception of class `error` if the file is absent, too large or compressed, or if its pickle
            refers to classes or functions other than those of plain tensors.
    """
    if not path.is_file():
        raise error(f"{path}: missing")
    if path.stat().st_size > limit:
        raise error(f"{path}: larger than {limit >> 20} MiB")
    try:
        if zipfile.is_zipfile(path):
            with open_archive(path, error) as archive:
                archive.refuse_packed()
                for name in archive.sizes:
                    if name.endswith("data.pkl"):
                        _refuse_calls(archive.read(name, _MAX_DESCRIPTION_BYTES))
        else:
            with open_regular(path, error) as file:
                for _ in range(_OLD_DESCRIPTIONS):
                    _refuse_calls(file)
    except ValueError as problem:
        raise error(f"{path}: not a readable file of plain tensors: {str(problem)[:200]}") from problem


def _refuse_calls(description: bytes | BinaryIO) -> None:
    """Checks that a pickle refers only to the classes and functions of plain tensors.

    Raises:
        ValueError: If the pickle refers to any other class or function.
    """
    for code, argument, _ in genops(description):
        odd = code.name == "GLOBAL" and not _PLAIN.fullmatch(str(argument))
        if odd or code.name in ("STACK_GLOBAL", "INST", "EXT1", "EXT2", "EXT4"):
            raise ValueError(f"it asks for {str(argument or code.name)[:80]}")


def read_tensors(path: Path, error: type[SplatwireError], limit: int = MAX_TENSOR_FILE_BYTES) -> Mapping[str, Any]:
    """Reads a dictionary of plain tensors.

    Args:
        path: The file, of any release of PyTorch from 0.4 on.
        error: Exception class to raise for an unsafe or damaged file.
        limit: Maximum size of the file, bytes.

    Returns:
        Read-only arrays by name, which may share memory; numbers and strings unchanged.

    Raises:
        SplatwireError: An exception of class `error` if `check_tensor_file` rejects the file, or if the file is damaged
            or contains objects other than tensors, numbers and strings.
    """
    check_tensor_file(path, error, limit)
    try:
        content, storages = _read_archive(path, error) if zipfile.is_zipfile(path) else _read_old(path, error)
        if not isinstance(content, dict):
            raise error(f"{path} holds a {type(content).__name__}, not tensors by name")
        tensors = _tensors_in(content)
        values = {**content, **{name: _array(tensor, storages) for name, tensor in tensors.items()}}
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError, EOFError, struct.error) as problem:
        raise error(f"{path} is not a readable file of tensors: {str(problem)[:200]}") from problem
    return values


_KINDS = {
    "Float": "<f4", "Double": "<f8", "Half": "<f2", "Long": "<i8", "Int": "<i4", "Short": "<i2",
    "Char": "i1", "Byte": "u1", "Bool": "?",
}  # fmt: skip
_MAGIC = 0x1950A86A20F9469CFC6C
_PROTOCOL = 1001
_IGNORED = ("PROTO", "FRAME", "STOP")
_SIZES = {"TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}
_CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False, "EMPTY_TUPLE": ()}


@dataclass(frozen=True)
class _Name:
    """Class or function that a pickle refers to by name."""

    name: str


@dataclass(frozen=True)
class _Storage:
    """Reference to the data of a tensor in a pickle: dtype, key in the archive, number of elements."""

    kind: str
    key: str
    count: int


@dataclass(frozen=True)
class _Tensor:
    """Tensor described by a pickle: storage, offset, shape and strides in elements."""

    storage: _Storage
    first: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]


def _read_archive(path: Path, error: type[SplatwireError]) -> tuple[Any, Callable[[_Storage], bytes]]:
    """Parses a zip archive written by `torch.save`, without importing or calling anything.

    Returns:
        Two values. The first is the content, with a description (`_Tensor`) in place of each tensor. The second is a
        function that returns the bytes of a storage, to which such a description refers.
    """
    with open_archive(path, error) as archive:
        described = [name for name in archive.sizes if name.endswith("/data.pkl")]
        if len(described) != 1:
            raise ValueError("it has no description of tensors")
        folder = described[0].removesuffix("data.pkl")
        if archive.sizes.get(f"{folder}byteorder") and archive.read_stored(f"{folder}byteorder", 16) != b"little":
            raise ValueError("its numbers are of another byte order")
        content = _interpreted(archive.read(described[0], _MAX_DESCRIPTION_BYTES))
        wanted = {tensor.storage.key for tensor in _tensors_in(content).values()}
        storages = {key: archive.read_stored(f"{folder}data/{key}", path.stat().st_size) for key in sorted(wanted)}
    return content, lambda storage: storages[storage.key]


def _read_old(path: Path, error: type[SplatwireError]) -> tuple[Any, Callable[[_Storage], bytes]]:
    """Parses a file that PyTorch wrote before version 1.6, without importing or calling anything.

    Returns:
        Two values. The first is the content, with a description (`_Tensor`) in place of each tensor. The second is a
        function that returns the bytes of a storage, to which such a description refers.
    """
    storages = dict[str, bytes]()
    with open_regular(path, error) as file:
        magic, protocol, _, content, keys = (_interpreted(file) for _ in range(_OLD_DESCRIPTIONS))
        if magic != _MAGIC or protocol != _PROTOCOL:
            raise ValueError("PyTorch did not write it")
        widths = {
            tensor.storage.key: np.dtype(tensor.storage.kind).itemsize for tensor in _tensors_in(content).values()
        }
        for key in keys:
            (count,) = struct.unpack("<q", file.read(8))
            if key not in widths or count < 0:
                raise ValueError("it holds more than tensors by name")
            storages[key] = file.read(min(count * widths[key], path.stat().st_size))
    return content, lambda storage: storages[storage.key]


def _tensors_in(content: Any) -> dict[str, _Tensor]:
    """Returns the tensors of a dictionary by name. The result is empty if `content` is no dictionary."""
    items = content.items() if isinstance(content, dict) else ()
    return {name: value for name, value in items if isinstance(value, _Tensor)}


def _array(tensor: _Tensor, bytes_of: Callable[[_Storage], bytes]) -> np.ndarray:
    """Converts the description of a tensor to a read-only array, possibly a view of shared memory.

    Args:
        tensor: Description of the tensor: shape, strides and position of its data.
        bytes_of: Function that returns the bytes of a data block of the archive.
    """
    numbers, shape, strides = np.frombuffer(bytes_of(tensor.storage), tensor.storage.kind), tensor.shape, tensor.strides
    last = tensor.first + sum((count - 1) * stride for count, stride in zip(shape, strides, strict=True))
    size = int(np.prod(shape, dtype=object))
    if min((tensor.first, *shape, *strides)) < 0 or size > len(numbers) or (size and last >= len(numbers)):
        raise ValueError("a tensor lies beside its numbers")
    width = numbers.itemsize
    steps = [stride * width for stride in strides]
    return np.lib.stride_tricks.as_strided(numbers[tensor.first :], shape, steps, writeable=False)


def _interpreted(description: bytes | BinaryIO) -> Any:
    """Parses a pickle of plain tensors without importing or calling anything.

    Args:
        description: The pickle.

    Returns:
        Content of the pickle, with a `_Tensor` in place of each tensor.

    Raises:
        ValueError: If the pickle contains anything but tensors, numbers, strings and collections of these.
    """
    stack, marks, memo = list[Any](), list[int](), dict[int, Any]()

    def since_mark() -> list[Any]:
        first = marks.pop()
        items = stack[first:]
        del stack[first:]
        return items

    for code, value_read, _ in genops(description):
        name, argument = code.name, cast(Any, value_read)
        if name in _IGNORED:
            continue
        if name == "MARK":
            marks.append(len(stack))
        elif name in _CONSTANTS:
            stack.append(_CONSTANTS[name])
        elif name in ("EMPTY_DICT", "EMPTY_LIST"):
            stack.append({} if name == "EMPTY_DICT" else [])
        elif name == "GLOBAL":
            stack.append(_Name(str(argument)))
        elif name in ("BINPUT", "LONG_BINPUT", "PUT", "MEMOIZE"):
            memo[len(memo) if name == "MEMOIZE" else int(argument)] = stack[-1]
        elif name in ("BINGET", "LONG_BINGET", "GET"):
            stack.append(memo[int(argument)])
        elif name in _SIZES:
            stack[-_SIZES[name] :] = [tuple(stack[-_SIZES[name] :])]
        elif name == "TUPLE":
            stack.append(tuple(since_mark()))
        elif name in ("APPEND", "APPENDS"):
            items = since_mark() if name == "APPENDS" else [stack.pop()]
            stack[-1].extend(items)
        elif name in ("SETITEM", "SETITEMS"):
            items = since_mark() if name == "SETITEMS" else [stack.pop(-2), stack.pop()]
            if not all(isinstance(key, str) for key in items[::2]):
                raise ValueError("its tensors have no names")
            stack[-1].update(zip(items[::2], items[1::2], strict=True))
        elif name == "BINPERSID":
            stack.append(_storage(*stack.pop()))
        elif name == "REDUCE":
            arguments = stack.pop()
            stack.append(_construct(stack.pop(), arguments))
        elif name == "BUILD":
            stack.pop()  # attributes of an ordered dictionary: module versions
        elif isinstance(argument, int | float | str):
            stack.append(argument)
        else:
            raise ValueError(f"its description has {name}")
    return stack[-1]


def _storage(word: str, kind: _Name, key: str, device: str, count: int, *views: Any) -> _Storage:
    """Parses the reference to a tensor's data in the pickle of a PyTorch file.

    The arguments are the items of the reference, in order.

    Args:
        word: Always `storage`.
        kind: Class of the data, which determines the dtype.
        key: Name of the data in the archive.
        device: Device; ignored.
        count: Number of elements.
        *views: Further items, which current releases of PyTorch do not write.

    Raises:
        ValueError: If the dtype is unknown, or the data is a view of other data.
    """
    name = kind.name.removeprefix("torch ").removesuffix("Storage")
    if word != "storage" or name not in _KINDS or not isinstance(key, str) or any(view is not None for view in views):
        raise ValueError(f"it holds {kind.name[:80]}")
    return _Storage(_KINDS[name], key, int(count))


def _construct(maker: Any, arguments: tuple[Any, ...]) -> Any:
    """Interprets a function call in a pickle without performing the call.

    Args:
        maker: The function that the pickle names.
        arguments: Arguments of the call.

    Returns:
        For a function that builds a tensor, the description of the tensor. For an ordered dictionary, a dictionary. For
        a parameter of a network, the tensor in the first argument.

    Raises:
        ValueError: If the function does not build a tensor, a parameter or an ordered dictionary.
    """
    name = maker.name if isinstance(maker, _Name) else ""
    if name == "collections OrderedDict":  # Python 2 passes its pairs as the argument
        return {key: value for key, value in (arguments[0] if arguments else ()) if isinstance(key, str)}
    if name == "torch._utils _rebuild_parameter":
        return arguments[0]
    if name == "torch._utils _rebuild_tensor_v2":
        storage, first, shape, strides = arguments[:4]
        if isinstance(storage, _Storage):
            return _Tensor(storage, int(first), tuple(map(int, shape)), tuple(map(int, strides)))
    raise ValueError(f"it asks for {str(name)[:80]}")
