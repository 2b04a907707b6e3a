"""Tensors of files are read without torch, and nothing else is."""

import random
import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from mutations import attack, mutated_bytes
from splatwire.errors import DatasetError
from splatwire.files.tensors import read_tensors
from tensor_files import numbers, save_described, save_tensors, tensor, text, whole


def made() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    return {
        "weight": rng.standard_normal((4, 3), np.float32), "turned": rng.standard_normal((3, 5)).T,
        "count": np.array(7), "flags": rng.random(9) < 0.5, "half": rng.random(4).astype(np.float16),
        "empty": np.empty((0, 3), np.float32),
    }  # fmt: skip


def test_tensors_are_read_as_they_were_written(tmp_path: Path) -> None:
    tensors = {name: np.ascontiguousarray(values) for name, values in made().items()}
    found = read_tensors(save_tensors(tensors, tmp_path / "a.pth"), DatasetError)
    assert found.keys() == tensors.keys()
    for name, values in tensors.items():
        assert found[name].dtype == values.dtype
        assert np.array_equal(found[name], values), name


@pytest.mark.parametrize("old", [False, True])
def test_files_of_torch_are_read(tmp_path: Path, old: bool) -> None:
    torch = pytest.importorskip("torch")
    tensors = {name: torch.from_numpy(np.array(values)) for name, values in made().items()}
    tensors["turned"] = torch.arange(30.0).view(5, 6).T[1:, ::2]
    tensors["parameter"] = torch.nn.Parameter(torch.ones(3))
    torch.save(tensors, tmp_path / "a.pth", _use_new_zipfile_serialization=not old)
    found = read_tensors(tmp_path / "a.pth", DatasetError)
    for name, values in tensors.items():
        assert np.array_equal(found[name], values.detach().numpy()), name


@pytest.mark.parametrize(
    ("description", "reason"),
    [
        (b"}(" + text("w") + tensor("0", "Float", 4, (5,), (1,)) + b"u", "lies beside"),
        (b"}(" + text("w") + tensor("0", "Float", 4, (4,), (1,), first=1) + b"u", "lies beside"),
        (b"}(" + text("w") + tensor("0", "Float", 4, (1 << 30, 1 << 30), (0, 0)) + b"u", "lies beside"),
        (b"}(" + text("w") + tensor("0", "Float", 4, (2,), (-1,), first=3) + b"u", "lies beside"),
        (b"}(" + text("w") + tensor("7", "Float", 4, (4,), (1,)) + b"u", "missing"),
        (b"}(" + text("w") + tensor("0", "Complex", 4, (4,), (1,)) + b"u", "torch ComplexStorage"),
        (b"}(" + whole(3) + tensor("0", "Float", 4, (4,), (1,)) + b"u", "no names"),
        (b"}(" + text("w") + b"cbuiltins\neval\n" + text("1") + b"\x85Ru", "asks for builtins eval"),
        (b"](" + whole(1) + b"e", "holds a list"),
        (b"0", "not a readable file"),
        (numbers((1, 2)), "holds a tuple"),
        (b"h\x05", "not a readable file"),
    ],
)  # fmt: skip
def test_everything_else_is_refused(tmp_path: Path, description: bytes, reason: str) -> None:
    path = save_described(description, [np.arange(4, dtype=np.float32).tobytes()], tmp_path / "a.pth")
    with pytest.raises(DatasetError, match=reason):
        read_tensors(path, DatasetError)


def test_shared_numbers_take_memory_once(tmp_path: Path) -> None:
    count = 1 << 18
    many = b"".join(text(f"w{i}") + tensor("0", "Float", count, (count,), (1,)) for i in range(200))
    path = save_described(b"}(" + many + b"u", [bytes(4 * count)], tmp_path / "a.pth")
    tracemalloc.start()
    found = read_tensors(path, DatasetError)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(found) == 200
    assert peak < 4 * path.stat().st_size


def test_deep_descriptions_are_refused(tmp_path: Path) -> None:
    deep = b")" + b"\x85" * 150_000
    made = b"ctorch._utils\n_rebuild_tensor_v2\n" + deep + b"R"
    for description in (b"}" + deep + whole(1) + b"s", b"}" + text("w") + made + b"s"):
        path = save_described(description, [], tmp_path / "a.pth")
        with pytest.raises(DatasetError):
            read_tensors(path, DatasetError)


@pytest.mark.filterwarnings("ignore:invalid escape sequence")  # of pickletools, about texts in the description
def test_damaged_files_raise_one_clear_error(tmp_path: Path) -> None:
    path = save_tensors({"weight": np.ones((4, 3), np.float32)}, tmp_path / "a.pth")
    data, rng = path.read_bytes(), random.Random(0)
    attack(path, lambda: mutated_bytes(data, rng), lambda: read_tensors(path, DatasetError), 200)


def test_old_file_of_something_else_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.pth"
    path.write_bytes(5 * (b"\x80\x02" + whole(1) + b".") + struct.pack("<q", 4))
    with pytest.raises(DatasetError, match="PyTorch did not write it"):
        read_tensors(path, DatasetError)
