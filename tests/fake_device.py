"""A simulated device for machines without a GPU; its tensors cannot be mixed with CPU tensors.

As on a GPU, operations with a CPU tensor fail (numbers excepted), and so does `.numpy()`. Only `.to` and `.cpu`
convert. It uses the name of torch's `meta` device, which has no other use here.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_map_only

DEVICE = torch.device("meta")
_CROSSING = (torch.ops.aten._to_copy.default, torch.ops.aten.copy_.default)


class FakeDeviceTensor(torch.Tensor):
    """A tensor that reports the simulated device."""

    inner: torch.Tensor

    @staticmethod
    def __new__(cls, inner: torch.Tensor) -> "FakeDeviceTensor":
        made: FakeDeviceTensor = torch.Tensor._make_wrapper_subclass(
            cls, inner.shape, strides=inner.stride(), storage_offset=inner.storage_offset(), dtype=inner.dtype,
            device=DEVICE,
        )  # fmt: skip
        made.inner = inner
        return made

    def __repr__(self) -> str:
        return f"pretend({self.inner!r})"

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _run(func, args, kwargs or {})


@contextmanager
def fake_device() -> Iterator[None]:
    """While active, tensors that are created on `DEVICE` or moved there become `FakeDeviceTensor`."""
    with _Operations(), _Literals():
        yield


class _Literals(TorchFunctionMode):
    """Tensors from numbers, which torch creates without a dispatch."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        if func is torch.Tensor.new_tensor and isinstance(args[0], FakeDeviceTensor):
            return torch.tensor(args[1], dtype=args[0].dtype).to(DEVICE)
        if func is torch.tensor and kwargs.get("device") == DEVICE:
            del kwargs["device"]
            return torch.tensor(*args, **kwargs).to(DEVICE)
        if func is torch.Tensor.__getitem__ and isinstance(args[0], FakeDeviceTensor):
            index = tuple(_on_device(part) for part in (args[1] if isinstance(args[1], tuple) else (args[1],)))
            return func(args[0], index)
        return func(*args, **kwargs)


def _on_device(index: Any) -> Any:
    return torch.tensor(index).to(DEVICE) if isinstance(index, list) else index


class _Operations(TorchDispatchMode):
    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _run(func, args, kwargs or {})


def _run(func: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
    wrappers: dict[int, FakeDeviceTensor] = {}
    strangers: list[torch.Tensor] = []

    def unwrapped(value: torch.Tensor) -> torch.Tensor:
        if isinstance(value, FakeDeviceTensor):
            wrappers[id(value.inner)] = value
            return value.inner
        if value.dim():
            strangers.append(value)
        return value

    plain_args, plain_kwargs = tree_map_only(torch.Tensor, unwrapped, (args, kwargs))
    assert not (wrappers and strangers) or func in _CROSSING, f"{func}: a tensor of the CPU met one of the device"
    target = plain_kwargs.get("device")
    if target is not None:
        plain_kwargs["device"] = torch.device("cpu")
    result = func(*plain_args, **plain_kwargs)
    elsewhere = target == DEVICE if target is not None else bool(wrappers)
    if func is torch.ops.aten.copy_.default:
        elsewhere = isinstance(args[0], FakeDeviceTensor)
    if not elsewhere:
        return result
    return tree_map_only(torch.Tensor, lambda r: wrappers[id(r)] if id(r) in wrappers else FakeDeviceTensor(r), result)
