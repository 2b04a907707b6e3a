"""Reader of the weights in a TorchScript archive; nothing in the archive is executed or unpickled.

The archive is a zip file. The member `data.pkl` describes a tree of modules and their tensors; the values of each
tensor are in a separate member.
"""

from dataclasses import dataclass
from pathlib import Path
from pickletools import genops
from typing import Any

import numpy as np
import torch
from torch import Tensor

from splatwire.errors import DatasetError
from splatwire.files.archive import Archive, open_archive

_MAX_BYTES = 64 << 20
_MAX_DESCRIPTION_BYTES = 1 << 20
_MAX_INSTRUCTIONS = 100_000
_MAX_MEMBERS, _MAX_NAME = 10_000, 1000
"""Limits of the module tree: maximum number of paths from the root to a member, maximum characters of a path."""
_TENSOR = "torch._utils _rebuild_tensor_v2"
_FLOATS = "torch FloatStorage"
_CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
_NUMBERS = {"BININT", "BININT1", "BININT2", "LONG1", "INT", "LONG"}
_TEXTS = {"BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8", "UNICODE"}
_MARK = object()


@dataclass
class _Node:
    """Module described in a TorchScript archive: class name, and members by name."""

    name: str
    members: dict[str, Any]


def is_torchscript(path: Path) -> bool:
    """Returns True if a file is a zip archive that contains TorchScript code."""
    try:
        with open_archive(path, DatasetError) as archive:
            return any(name.endswith("/constants.pkl") or "/code/" in name for name in archive.sizes)
    except DatasetError:
        return False


def read_torchscript_weights(path: Path) -> dict[str, Tensor]:
    """Returns the float32 tensors of a TorchScript module, named as in a state dictionary (`0.weight`).

    Raises:
        DatasetError: If the archive is damaged or too large, or describes anything but modules with float32 tensors.
    """
    try:
        with open_archive(path, DatasetError) as archive:
            if path.stat().st_size > _MAX_BYTES:
                raise DatasetError(f"{path}: larger than {_MAX_BYTES >> 20} MiB")
            description = next(name for name in archive.sizes if name.endswith("/data.pkl"))
            tensors = _Tensors(archive, description.removesuffix("data.pkl"))
            root = _follow(tensors, archive.read_stored(description, _MAX_DESCRIPTION_BYTES))
        weights = _collect(root)
    except DatasetError:
        raise
    except StopIteration as error:
        raise DatasetError(f"{path}: a TorchScript archive without data.pkl") from error
    except Exception as error:  # a damaged file raises exceptions of many types
        raise DatasetError(
            f"{path}: its TorchScript cannot be read safely ({str(error)[:120]}); load it where it was trained and "
            "save torch.save(module.state_dict(), path) instead"
        ) from error
    if not weights:
        raise DatasetError(f"{path}: has no weights")
    return weights


def _collect(root: Any) -> dict[str, Tensor]:
    """Returns the tensors of a tree of modules, keyed by their dotted path, such as `0.weight`."""
    weights: dict[str, Tensor] = {}
    todo, seen = [("", root)], 0
    while todo:
        prefix, value = todo.pop()
        members = value.members.items() if isinstance(value, _Node) else ()
        seen += len(members)
        if seen > _MAX_MEMBERS or len(prefix) > _MAX_NAME:  # cyclic or exponentially nested modules
            raise ValueError(f"more than {_MAX_MEMBERS} members of modules, or names longer than {_MAX_NAME}")
        for name, member in members:
            if isinstance(member, Tensor):
                weights[f"{prefix}{name}"] = member
            else:
                todo.append((f"{prefix}{name}.", member))
    return weights


def _follow(tensors: "_Tensors", description: bytes) -> Any:
    """Parses a pickle that describes a tree of modules and their tensors; no code of the pickle is executed.

    Args:
        tensors: Reader of the archive's tensors.
        description: The pickle.

    Returns:
        The root module.

    Raises:
        ValueError: If the pickle contains any other value or instruction.
    """
    # `data.pkl` is a program for a stack machine. Only the few instructions that describe tensors and names are
    # interpreted; others are errors.
    stack: list[Any] = []
    memory: dict[int, Any] = {}
    for count, (code, argument, _) in enumerate(genops(description)):
        name = code.name
        if count > _MAX_INSTRUCTIONS:
            raise ValueError("too many instructions")
        if name == "STOP":
            return stack.pop()
        if name in ("PROTO", "FRAME"):
            continue
        if name in _CONSTANTS:
            stack.append(_CONSTANTS[name])
        elif name in _NUMBERS or name in _TEXTS or name == "GLOBAL":
            stack.append(argument)
        elif name in ("BINPUT", "LONG_BINPUT"):
            memory[_key(argument)] = stack[-1]
        elif name in ("BINGET", "LONG_BINGET"):
            stack.append(memory[_key(argument)])
        elif name == "BINPERSID":
            stack.append(tensors.storage(stack.pop()))
        else:
            _build(name, stack, tensors)
    raise ValueError("the description does not end")


def _key(argument: Any) -> int:
    return int(argument)


def _build(name: str, stack: list[Any], tensors: "_Tensors") -> None:
    """Executes a pickle instruction that builds a tuple, list, dictionary, module or tensor, without calling any code.

    Args:
        name: Name of the instruction.
        stack: Stack of the pickle machine; changed in place.
        tensors: Reader of the archive's tensors.

    Raises:
        ValueError: If the instruction is unknown, or would build a value of any other kind.
    """
    if name in ("MARK", "EMPTY_DICT", "EMPTY_LIST", "EMPTY_TUPLE"):
        stack.append({"MARK": _MARK, "EMPTY_DICT": {}, "EMPTY_LIST": [], "EMPTY_TUPLE": ()}[name])
    elif name == "TUPLE":
        stack.append(tuple(_since_mark(stack)))
    elif name in ("TUPLE1", "TUPLE2", "TUPLE3"):
        count = int(name[-1])
        stack[-count:] = [tuple(stack[-count:])]
    elif name in ("SETITEM", "SETITEMS"):
        items = _since_mark(stack) if name == "SETITEMS" else [stack.pop() for _ in range(2)][::-1]
        stack[-1].update(zip(items[::2], items[1::2], strict=True))
    elif name in ("APPEND", "APPENDS"):
        items = _since_mark(stack) if name == "APPENDS" else [stack.pop()]
        stack[-1].extend(items)
    elif name == "NEWOBJ":
        arguments, kind = stack.pop(), stack.pop()
        if arguments != () or not str(kind).startswith("__torch__"):
            raise ValueError(f"it builds a {kind}")
        stack.append(_Node(str(kind), {}))
    elif name == "BUILD":
        members = stack.pop()
        if not isinstance(stack[-1], _Node) or not isinstance(members, dict):
            raise ValueError("it fills something that is not a module")
        stack[-1].members.update(members)
    elif name == "REDUCE":
        arguments, function = stack.pop(), stack.pop()
        stack.append({} if _is_dictionary(str(function), arguments) else tensors.tensor(str(function), arguments))
    else:
        raise ValueError(f"instruction {name}")


def _is_dictionary(function: str, arguments: tuple[Any, ...]) -> bool:
    return function == "collections OrderedDict" and arguments == ()


class _Tensors:
    """Reader of the tensors in an archive."""

    def __init__(self, archive: Archive, folder: str) -> None:
        self._archive, self._folder = archive, folder
        self._storages: dict[str, np.ndarray] = {}

    def storage(self, reference: tuple[Any, ...]) -> np.ndarray:
        """Returns the values of a storage as float32.

        A storage is a flat array in the archive. Tensors are views of it.

        Args:
            reference: Persistent id of the storage in the pickle; states its type, its name and its number of values.

        Raises:
            ValueError: If the storage is not float32, has another number of values than stated,
                or has non-finite numbers.
        """
        word, kind, key, _, count = reference
        if word != "storage" or kind != _FLOATS or not str(key).isdigit():
            raise ValueError(f"numbers of kind {kind}")
        if key not in self._storages:
            data = self._archive.read_stored(f"{self._folder}data/{key}", _MAX_BYTES)
            numbers = np.frombuffer(bytearray(data), "<f4")
            if not np.isfinite(numbers).all():
                raise ValueError(f"storage {key} has numbers that are not finite")
            self._storages[key] = numbers
        if len(self._storages[key]) != count:
            raise ValueError(f"{len(self._storages[key])} numbers where {count} were promised")
        return self._storages[key]

    def tensor(self, function: str, arguments: tuple[Any, ...]) -> Tensor:
        """Builds a tensor from a pickled call of `_rebuild_tensor_v2`, without executing the call.

        Args:
            function: Name of the called function.
            arguments: Arguments of the call: the values of the storage, the offset, the shape and the strides.

        Raises:
            ValueError: If the called function is not `_rebuild_tensor_v2`, or the tensor is not a contiguous part of
                its storage.
        """
        if function != _TENSOR:
            raise ValueError(f"it calls {function}")
        numbers, offset, shape, stride = arguments[:4]
        if not isinstance(numbers, np.ndarray):
            raise ValueError("a tensor without numbers")
        size = int(np.prod(shape, dtype=np.int64))
        dense = tuple(int(np.prod(shape[axis + 1 :], dtype=np.int64)) for axis in range(len(shape)))
        if tuple(stride) != dense or not 0 <= offset <= len(numbers) - size or min(shape, default=1) < 1:
            raise ValueError(f"a tensor of shape {shape}, stride {stride} in {len(numbers)} numbers")
        return torch.from_numpy(numbers[offset : offset + size].reshape(shape))


def _since_mark(stack: list[Any]) -> list[Any]:
    position = len(stack) - 1
    while stack[position] is not _MARK:
        position -= 1
        if position < 0:
            raise ValueError("a mark is missing")
    items = stack[position + 1 :]
    del stack[position:]
    return items
