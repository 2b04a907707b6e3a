"""A counter of kernel launches and blocking copies of an iteration, without a GPU.

It counts forward and backward operations on tensors of the pretend device. Views launch no kernel. The renderer is
excluded, because its replacement has many operations and a real one has few kernels.
"""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_iter

from fake_device import DEVICE, FakeDeviceTensor

_FREE = ("empty", "new_empty", "new_empty_strided", "empty_like", "empty_strided", "_unsafe_view", "_reshape_alias")
_WAITING = ("nonzero", "_local_scalar_dense", "masked_select", "equal", "is_nonzero", "unique_dim", "_unique2")
_CROSSING = ("_to_copy", "copy_")


class Launches(TorchDispatchMode):
    """Counts operations while active.

    Attributes:
        operations: Launches by operation.
        host: Copies between host and device, and counts that the host waits for, by operation.
    """

    def __init__(self) -> None:
        super().__init__()
        self.operations: Counter[str] = Counter()
        self.host: Counter[str] = Counter()
        self._paused = False

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        tensors = [value for value in tree_iter((args, kwargs)) if isinstance(value, torch.Tensor)]
        near = any(isinstance(tensor, FakeDeviceTensor) for tensor in tensors)
        target = kwargs.get("device")
        name = func.overloadpacket.__name__
        if (near or target == DEVICE) and not self._paused and not func.is_view and name not in _FREE:
            sources = tensors[1:] if name == "copy_" else tensors
            elsewhere = target is not None and near != (target == DEVICE) and bool(tensors)
            mixed = name == "copy_" and any(not isinstance(tensor, FakeDeviceTensor) for tensor in sources)
            if name in _WAITING or (name in _CROSSING and (elsewhere or mixed)):
                self.host[name] += 1
            self.operations[name] += 1
        return func(*args, **kwargs)

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Suspends counting."""
        before, self._paused = self._paused, True
        try:
            yield
        finally:
            self._paused = before

    def rasterization(self, means: torch.Tensor, *others: torch.Tensor | int, **options: Any) -> Any:
        """A renderer that is not counted: grey pictures, and equal gradients for all numbers of a Gaussian."""
        width, height = others[-2:]
        centers = _Uncounted.apply(self, (1, len(means), 2), means)
        images = _Uncounted.apply(self, (1, height, width, 3), centers, *others[:4])
        return images, None, {"means2d": centers}


class _Uncounted(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, counter: Launches, shape: tuple[int, ...], *inputs: torch.Tensor) -> torch.Tensor:
        ctx.counter, ctx.inputs = counter, inputs
        with counter.paused():
            return inputs[0].new_full(shape, 0.5)

    @staticmethod
    def backward(ctx: Any, *upstream: torch.Tensor) -> Any:
        with ctx.counter.paused():
            return None, None, *(torch.full_like(value, 1e-3) for value in ctx.inputs)
