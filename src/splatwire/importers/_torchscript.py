"""Reads the weights out of a TorchScript archive without running or unpickling anything in it.

Such an archive is a zip file. Its `data.pkl` describes a tree of modules with their tensors, each tensor's numbers are
a file of their own. The description is a program for a stack machine; here its instructions are only listed, and the
few that describe tensors and names are followed. Whatever else a file asks for is refused.
"""

import zipfile
from dataclasses import dataclass
from pathlib import Path
from pickletools import genops
from typing import Any

import numpy as np
import torch
from torch import Tensor

from splatwire.errors import DatasetError

_MAX_BYTES = 64 << 20
_MAX_INSTRUCTIONS = 100_000
_TENSOR = "torch._utils _rebuild_tensor_v2"
_FLOATS = "torch FloatStorage"
_CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
_NUMBERS = {"BININT", "BININT1", "BININT2", "LONG1", "INT", "LONG"}
_TEXTS = {"BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8", "UNICODE"}
_MARK = object()


@dataclass
class _Node:
    """A module: what its class is called, and its members."""

    name: str
    members: dict[str, Any]


def is_torchscript(path: Path) -> bool:
    """Tells whether a file is a zip archive with TorchScript code in it."""
    try:
        with zipfile.ZipFile(path) as archive:
            return any(name.endswith("/constants.pkl") or "/code/" in name for name in archive.namelist())
    except (OSError, zipfile.BadZipFile):
        return False


def read_torchscript_weights(path: Path) -> dict[str, Tensor]:
    """Returns the float32 tensors of a TorchScript module, named as in a state dictionary (`0.weight`).

    Raises:
        DatasetError: If the archive is damaged or too large, or describes anything but modules with float32 tensors.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > _MAX_BYTES:
                raise DatasetError(f"{path}: larger than {_MAX_BYTES >> 20} MiB")
            description = next(name for name in archive.namelist() if name.endswith("/data.pkl"))
            root = _follow(archive, description.removesuffix("data.pkl"), archive.read(description))
        weights: dict[str, Tensor] = {}
        _collect(root, "", weights)
    except DatasetError:
        raise
    except StopIteration as error:
        raise DatasetError(f"{path}: a TorchScript archive without data.pkl") from error
    except Exception as error:  # zip, stack machine and numpy raise many kinds on a damaged file; all mean the same
        raise DatasetError(
            f"{path}: its TorchScript cannot be read safely ({str(error)[:120]}); load it where it was trained and "
            "save torch.save(module.state_dict(), path) instead"
        ) from error
    if not weights:
        raise DatasetError(f"{path}: has no weights")
    return weights


def _collect(value: Any, prefix: str, weights: dict[str, Tensor]) -> None:
    if isinstance(value, _Node):
        for name, member in value.members.items():
            if isinstance(member, Tensor):
                weights[prefix + name] = member
            else:
                _collect(member, f"{prefix}{name}.", weights)


def _follow(archive: zipfile.ZipFile, folder: str, description: bytes) -> Any:
    """Follows the instructions that build modules and tensors; any other is an error."""
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
            stack.append(_storage(archive, folder, stack.pop()))
        else:
            _build(name, stack)
    raise ValueError("the description does not end")


def _key(argument: Any) -> int:
    return int(argument)


def _build(name: str, stack: list[Any]) -> None:
    """The instructions that put parts together."""
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
        stack.append(_call(str(function), arguments))
    else:
        raise ValueError(f"instruction {name}")


def _call(function: str, arguments: tuple[Any, ...]) -> Any:
    """The two calls that descriptions of modules consist of; nothing is looked up by name."""
    if function == "collections OrderedDict" and arguments == ():
        return {}
    if function != _TENSOR:
        raise ValueError(f"it calls {function}")
    numbers, offset, shape, stride = arguments[:4]
    if not isinstance(numbers, np.ndarray):
        raise ValueError("a tensor without numbers")
    size = int(np.prod(shape, dtype=np.int64))
    dense = tuple(int(np.prod(shape[axis + 1 :], dtype=np.int64)) for axis in range(len(shape)))
    if tuple(stride) != dense or not 0 <= offset <= len(numbers) - size or min(shape, default=1) < 1:
        raise ValueError(f"a tensor of shape {shape}, stride {stride} in {len(numbers)} numbers")
    return torch.from_numpy(numbers[offset : offset + size].reshape(shape).copy())


def _storage(archive: zipfile.ZipFile, folder: str, reference: tuple[Any, ...]) -> np.ndarray:
    word, kind, key, _, count = reference
    if word != "storage" or kind != _FLOATS or not str(key).isdigit():
        raise ValueError(f"numbers of kind {kind}")
    numbers = np.frombuffer(archive.read(f"{folder}data/{key}"), dtype="<f4")
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise ValueError(f"{len(numbers)} numbers where {count} finite ones were promised")
    return numbers


def _since_mark(stack: list[Any]) -> list[Any]:
    position = len(stack) - 1
    while stack[position] is not _MARK:
        position -= 1
        if position < 0:
            raise ValueError("a mark is missing")
    items = stack[position + 1 :]
    del stack[position:]
    return items
