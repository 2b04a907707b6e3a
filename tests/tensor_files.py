"""Files of plain tensors as `torch.save` writes them, put together by hand."""

import struct
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from random_numbers import Numbers

KINDS = {"float32": "Float", "float64": "Double", "int64": "Long", "float16": "Half", "bool": "Bool"}
ALEX = (
    {0: (64, 3, 11), 3: (192, 64, 5), 6: (384, 192, 3), 8: (256, 384, 3), 10: (256, 256, 3)},
    (64, 192, 384, 256, 256), "alexnet_features.pth", "lpips_lin_alex.pth",
)  # fmt: skip


def text(value: str) -> bytes:
    """Encodes a text of a pickle."""
    return b"X" + struct.pack("<I", len(value)) + value.encode()


def whole(number: int) -> bytes:
    """Encodes a whole number of a pickle."""
    return b"J" + struct.pack("<i", number)


def numbers(values: tuple[int, ...]) -> bytes:
    """Encodes a tuple of whole numbers of a pickle."""
    return b"(" + b"".join(whole(value) for value in values) + b"t"


def tensor(key: str, kind: str, count: int, shape: tuple[int, ...], strides: tuple[int, ...], first: int = 0) -> bytes:
    """Encodes the description of a tensor in a storage of `count` numbers."""
    storage = b"(" + text("storage") + f"ctorch\n{kind}Storage\n".encode() + text(key) + text("cpu") + whole(count)
    hooks = b"\x89ccollections\nOrderedDict\n)R"
    made = b"(" + storage + b"tQ" + whole(first) + numbers(shape) + numbers(strides) + hooks + b"tR"
    return b"ctorch._utils\n_rebuild_tensor_v2\n" + made


def save_tensors(tensors: Mapping[str, np.ndarray], path: Path) -> Path:
    """Writes arrays by name."""
    parts = []
    for key, (name, values) in enumerate(tensors.items()):
        strides = tuple(step // values.itemsize for step in values.strides)
        parts.append(text(name) + tensor(str(key), KINDS[str(values.dtype)], values.size, values.shape, strides))
    storages = [np.ascontiguousarray(values).tobytes() for values in tensors.values()]
    return save_described(b"}(" + b"".join(parts) + b"u", storages, path)


def save_described(description: bytes, storages: list[bytes], path: Path) -> Path:
    """Writes any description with the bytes of its storages."""
    with zipfile.ZipFile(path, "w") as bundle:
        bundle.writestr("archive/data.pkl", b"\x80\x02" + description + b".")
        bundle.writestr("archive/byteorder", b"little")
        for key, data in enumerate(storages):
            bundle.writestr(f"archive/data/{key}", data)
    return path


def write_lpips_weights(folder: Path) -> tuple[Path, Path]:
    """Made-up weights of LPIPS with AlexNet: the files of the backbone and of the linear layers."""
    rng, features = Numbers(1), dict[str, np.ndarray]()
    convolutions, channels, file, linear_file = ALEX
    for key, (outputs, inputs, kernel) in convolutions.items():
        spread = np.float32((2 / (inputs * kernel * kernel)) ** 0.5)
        features[f"features.{key}.weight"] = rng.randn(outputs, inputs, kernel, kernel) * spread
        features[f"features.{key}.bias"] = np.float32(0.1) * rng.randn(outputs)
    linear = {f"lin{i}.model.1.weight": rng.rand(1, count, 1, 1) for i, count in enumerate(channels)}
    return save_tensors(features, folder / file), save_tensors(linear, folder / linear_file)
