"""A Scaffold-GS folder written from a synthetic scene in the published layout."""

import dataclasses
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from close import assert_close
from scenes import tiny_cameras, tiny_scene
from splatwire.codec import decode_stream, encode_scene
from splatwire.errors import DatasetError
from splatwire.metrics import psnr
from splatwire.neural.importers._torchscript import read_torchscript_weights
from splatwire.neural.importers.scaffold import import_scaffold
from splatwire.neural.model.tensors import to_tensors
from splatwire.render import render_scene
from splatwire.types import AnchorScene, Mlp

SCENE = tiny_scene(num_anchors=120)
K, F = 4, 12
ENDS = {"opacity": nn.Tanh(), "cov": None, "color": nn.Sigmoid()}


def _module(mlp: Mlp, end: nn.Module | None, *, distance: bool, appearance: torch.Tensor | None) -> nn.Sequential:
    mlp = to_tensors(mlp)
    weight = mlp.hidden.weight if distance else mlp.hidden.weight[:, :-1]
    if appearance is not None:
        weight = torch.cat([weight, appearance], dim=1)
    first, second = nn.Linear(weight.shape[1], weight.shape[0]), nn.Linear(*mlp.output.weight.shape[::-1])
    with torch.no_grad():
        first.weight.copy_(weight)
        first.bias.copy_(mlp.hidden.bias)
        second.weight.copy_(mlp.output.weight)
        second.bias.copy_(mlp.output.bias)
    return nn.Sequential(first, nn.ReLU(True), second, *([end] if end else []))


def write_model(
    root: Path, *, script: bool = True, distance: bool = True, appearance: torch.Tensor | None = None
) -> Path:
    iteration = root / "point_cloud" / "iteration_30000"
    iteration.mkdir(parents=True)
    anchors = to_tensors(SCENE.anchors)
    columns = [anchors.positions, torch.zeros(120, 3), anchors.offsets.transpose(1, 2).flatten(1), anchors.features,
               torch.zeros(120, 1), anchors.scalings.log(), torch.zeros(120, 4)]  # fmt: skip
    names = ["x", "y", "z", "nx", "ny", "nz", *(f"f_offset_{i}" for i in range(3 * K)),
             *(f"f_anchor_feat_{i}" for i in range(F)), "opacity", *(f"scale_{i}" for i in range(6)),
             *(f"rot_{i}" for i in range(4))]  # fmt: skip
    head = ["ply", "format binary_little_endian 1.0", "element vertex 120", *(f"property float {n}" for n in names)]
    body = torch.cat(columns, dim=1).numpy().astype("<f4").tobytes()
    (iteration / "point_cloud.ply").write_bytes(("\n".join(head) + "\nend_header\n").encode() + body)
    (root / "cfg_args").write_text("Namespace(feat_dim=12, voxel_size=0.015625)")
    heads = {"opacity": SCENE.heads.opacity, "cov": SCENE.heads.covariance, "color": SCENE.heads.color}
    for name, mlp in heads.items():
        extra = appearance if name == "color" else None
        module = _module(mlp, ENDS[name], distance=distance, appearance=extra).eval()
        path = iteration / f"{name}_mlp.pt"
        if not script:
            torch.save(module.state_dict(), path)
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # TorchScript is being retired, but these files use it
            torch.jit.trace(module, (torch.rand(1, module[0].in_features),)).save(str(path))
    return root


def _pictures(scene: AnchorScene) -> np.ndarray:
    return render_scene(scene, tiny_cameras())


@pytest.mark.parametrize("script", [True, False])
def test_renders_equal_those_of_the_model(script: bool, tmp_path: Path) -> None:
    scene = import_scaffold(write_model(tmp_path, script=script))
    assert scene.coding.voxel_size == 0.015625
    assert bool(scene.anchors.mask.all())
    assert np.array_equal(scene.anchors.positions, SCENE.anchors.positions)
    assert np.array_equal(scene.anchors.features, SCENE.anchors.features)
    assert np.array_equal(scene.heads.color.hidden.weight, SCENE.heads.color.hidden.weight)
    everything = np.ones_like(SCENE.anchors.mask)
    unmasked = dataclasses.replace(SCENE, anchors=dataclasses.replace(SCENE.anchors, mask=everything))
    assert_close(_pictures(scene), _pictures(unmasked), atol=2e-3, rtol=0)


def test_models_without_distance_input_get_zero_weight(tmp_path: Path) -> None:
    scene = import_scaffold(write_model(tmp_path, distance=False))
    weight = scene.heads.opacity.hidden.weight
    assert np.array_equal(weight[:, :-1], SCENE.heads.opacity.hidden.weight[:, :-1])
    assert bool((weight[:, -1] == 0).all())


def test_appearance_of_one_camera_is_kept(tmp_path: Path) -> None:
    columns = torch.randn(16, 3, generator=torch.Generator().manual_seed(1))
    write_model(tmp_path, appearance=columns)
    table = torch.randn(5, 3, generator=torch.Generator().manual_seed(2))
    torch.save({"embedding.weight": table}, tmp_path / "point_cloud" / "iteration_30000" / "embedding_appearance.pt")
    for choice in (None, 5, -1):
        with pytest.raises(DatasetError, match="from 0 to 4 with --appearance"):
            import_scaffold(tmp_path, appearance=choice)
    hidden = import_scaffold(tmp_path, appearance=3).heads.color.hidden
    assert_close(hidden.bias, SCENE.heads.color.hidden.bias + (columns @ table[3]).numpy())
    assert np.array_equal(hidden.weight, SCENE.heads.color.hidden.weight)


@pytest.mark.slow
def test_imported_scene_is_encoded_and_decoded(tmp_path: Path) -> None:
    scene = import_scaffold(write_model(tmp_path))
    stream = encode_scene(scene)
    decoded = decode_stream(stream).scene
    assert decoded.anchors.num_anchors == 120
    assert float(psnr(_pictures(decoded), _pictures(scene)).mean()) > 30
    assert stream.num_bytes < 120 * 4 * (3 + F + 6 + 3 * K) + 20_000


def test_other_models_are_refused(tmp_path: Path) -> None:
    root = write_model(tmp_path / "m")
    iteration = root / "point_cloud" / "iteration_30000"
    (iteration / "feature_bank_mlp.pt").write_bytes(b"")
    with pytest.raises(DatasetError, match="feature bank"):
        import_scaffold(root)
    (iteration / "feature_bank_mlp.pt").unlink()
    good = (iteration / "cov_mlp.pt").read_bytes()
    for content, reason in ((good[:400], "cov_mlp"), (b"", "cov_mlp")):
        (iteration / "cov_mlp.pt").write_bytes(content)
        with pytest.raises(DatasetError, match=reason):
            import_scaffold(root)
    (iteration / "cov_mlp.pt").write_bytes((iteration / "color_mlp.pt").read_bytes())
    with pytest.raises(DatasetError, match=r"cov_mlp.*shape"):
        import_scaffold(root)
    with pytest.raises(DatasetError, match="no such file or folder"):
        import_scaffold(tmp_path / "absent")


def _archive(path: Path, description: bytes, numbers: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("m/data.pkl", description)
        archive.writestr("m/constants.pkl", b"")
        for key, data in numbers.items():
            archive.writestr(f"m/data/{key}", data)
    return path


@pytest.mark.parametrize(
    "description",
    [
        b"\x80\x02cposix\nsystem\nX\x04\0\0\0echo\x85R.",  # calls a function
        b"\x80\x02cbuiltins\nobject\n)\x81}b.",  # builds an object that is no module
        b"\x80\x02c__torch__.M\n)\x81}X\x01\0\0\0aK\x01sb",  # never ends
        b"\x80\x02(lp0\n.",  # an instruction that modules do not need
        b"\x80\x02t.",  # no mark
        b"",
    ],
)
def test_archives_with_more_than_tensors_are_refused(description: bytes, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"m\.pt"):
        read_torchscript_weights(_archive(tmp_path / "m.pt", description, {"0": bytes(16)}))


def test_inconsistent_shapes_are_refused(tmp_path: Path) -> None:
    module = nn.Sequential(nn.Linear(3, 2)).eval()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.jit.trace(module, (torch.rand(1, 3),)).save(str(tmp_path / "a.pt"))
    found = read_torchscript_weights(tmp_path / "a.pt")
    assert torch.equal(found["0.weight"], module[0].weight)
    with zipfile.ZipFile(tmp_path / "a.pt") as archive:
        description = archive.read(next(n for n in archive.namelist() if n.endswith("/data.pkl")))
    for numbers in (
        {"0": bytes(20), "1": bytes(8)},
        {"0": bytes(24)},
        {"0": np.full(6, np.nan, "<f4").tobytes(), "1": bytes(8)},
    ):
        with pytest.raises(DatasetError, match=r"cannot be read safely|m/data/1 is missing"):
            read_torchscript_weights(_archive(tmp_path / "b.pt", description, numbers))
