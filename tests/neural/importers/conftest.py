import io
import struct
from pathlib import Path

import numpy as np
import pytest
import torch

RESOLUTIONS = {"xyz": (4, 9), "xy": (5, 17), "xz": (5, 17), "yz": (5, 17)}
ROWS = {"xyz": (64, 128), "xy": (32, 128), "xz": (32, 128), "yz": (32, 128)}  # tables of 2**7 rows
VOXEL_SIZE = 0.02
N, K, F, GROUPS = 9, 2, 5, (2, 3)
H = 2 * (2 + 3 * 2)


def write_ply(path: Path, columns: dict[str, np.ndarray]) -> None:
    count = len(next(iter(columns.values())))
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    head += [f"property float {name}" for name in columns] + ["end_header", ""]
    body = b"".join(struct.pack("<f", value) for row in zip(*columns.values(), strict=True) for value in row)
    path.write_bytes("\n".join(head).encode() + body)


class Model:
    """A tiny model folder in the layout of the official HAC++ code, and its values."""

    def __init__(self, root: Path) -> None:
        rng = np.random.default_rng(3)
        self.root = root
        self.iteration = root / "point_cloud" / "iteration_300"
        self.voxels = rng.integers(-40, 60, (N, 3))
        self.positions = self.voxels.astype(np.float32) * np.float32(VOXEL_SIZE)
        self.mask = rng.random((N, K)) > 0.4
        self.mask[:, 0] |= ~self.mask.any(axis=1)
        self.features = rng.normal(size=(N, F)).astype(np.float32)
        self.scalings = rng.random((N, 6)).astype(np.float32)
        self.offsets = rng.normal(size=(N, K, 3)).astype(np.float32)
        self.bounds = np.float32([[-1.5, -1.25, -2.0]]), np.float32([[2.0, 2.25, 1.5]])
        g = torch.Generator().manual_seed(5)
        self.checkpoint = make_checkpoint(g)

    def columns(self) -> dict[str, np.ndarray]:
        columns = {axis: self.positions[:, i] for i, axis in enumerate("xyz")}
        columns |= {f"n{axis}": np.zeros(N) for axis in "xyz"}
        for i in range(3 * K):  # all x, all y, all z
            columns[f"f_offset_{i}"] = self.offsets[:, i % K, i // K]
        columns |= {f"f_mask_{k}": self.mask[:, k].astype(np.float32) for k in range(K)} | {f"f_mask_{K}": np.zeros(N)}
        columns |= {f"f_anchor_feat_{f}": self.features[:, f] for f in range(F)}
        columns |= {"opacity": np.zeros(N)} | {f"scale_{i}": self.scalings[:, i] for i in range(6)}
        return columns | {f"rot_{i}": np.full(N, float(i == 0)) for i in range(4)}

    def write(self, columns: dict[str, np.ndarray] | None = None) -> Path:
        bits = self.root / "bitstreams"
        self.iteration.mkdir(parents=True, exist_ok=True)
        bits.mkdir(exist_ok=True)
        write_ply(self.iteration / "point_cloud.ply", columns or self.columns())
        torch.save(self.checkpoint, self.iteration / "checkpoint.pth")
        for name, value in zip(("min", "max"), self.bounds, strict=True):
            torch.save(torch.from_numpy(value), bits / f"x_bound_{name}.pkl")
        np.savez(bits / "xyz_gpcc.npz", voxel_size=VOXEL_SIZE, means_strings=b"points")
        return self.root


def make_checkpoint(g: torch.Generator, tiny_deform: bool = False) -> dict:
    def network(inputs: int, outputs: int, hidden: int, prefix: str = "") -> dict:
        shapes = {
            "0.weight": (hidden, inputs),
            "0.bias": (hidden,),
            "2.weight": (outputs, hidden),
            "2.bias": (outputs,),
        }
        return {prefix + name: torch.randn(shape, generator=g) for name, shape in shapes.items()}

    encoding = {}
    for name, rows in ROWS.items():
        params = torch.randn(sum(rows), 2, generator=g)
        params[0, 0] = 0.0
        encoding[f"encoding_{name}.params"] = params
        encoding[f"encoding_{name}.offsets_list"] = torch.tensor([0, *np.cumsum(rows)], dtype=torch.int32)
        encoding[f"encoding_{name}.resolutions_list"] = torch.tensor(RESOLUTIONS[name], dtype=torch.int32)
    if tiny_deform:
        deform = {"MLP_d0": torch.randn(1, 6, generator=g)} | network(2, 9, 7, "MLP_d1.")
    else:
        deform = network(15, 6, 4, "MLP_d0.") | network(17, 9, 4, "MLP_d1.")
    return {
        "opacity_mlp": network(F + 4, K, 4),
        "cov_mlp": network(F + 4, 7 * K, 4),
        "color_mlp": network(F + 4, 3 * K, 4),
        "encoding_xyz": encoding,
        "grid_mlp": network(H, 3 * F + 12 + 6 * K + 3, 8),
        "deform_mlp": deform,
    }


@pytest.fixture
def model(tmp_path) -> Model:
    return Model(tmp_path / "model")


@pytest.fixture
def tiny_deform_checkpoint() -> dict:
    return make_checkpoint(torch.Generator().manual_seed(6), tiny_deform=True)


@pytest.fixture
def malicious_bytes() -> bytes:
    """A torch file that would run code when unpickled."""

    class Runs:
        def __reduce__(self):
            return (exec, ("import builtins; builtins.splatwire_was_here = True",))

    buffer = io.BytesIO()
    torch.save({"opacity_mlp": Runs()}, buffer)
    return buffer.getvalue()
