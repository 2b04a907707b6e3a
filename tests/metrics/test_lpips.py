"""LPIPS with synthetic weights, and with the real ones if installed."""

from pathlib import Path

import numpy as np
import pytest
import torch

from splatwire.errors import DatasetError, UnknownNameError
from splatwire.metrics.lpips import Lpips, find_lpips, load_lpips

LAYOUTS = {
    "vgg": (
        {0: (64, 3, 3), 2: (64, 64, 3), 5: (128, 64, 3), 7: (128, 128, 3), 10: (256, 128, 3), 12: (256, 256, 3),
         14: (256, 256, 3), 17: (512, 256, 3), 19: (512, 512, 3), 21: (512, 512, 3), 24: (512, 512, 3),
         26: (512, 512, 3), 28: (512, 512, 3)},
        (64, 128, 256, 512, 512), "vgg16_features.pth", "lpips_lin_vgg.pth",
    ),
    "alex": (
        {0: (64, 3, 11), 3: (192, 64, 5), 6: (384, 192, 3), 8: (256, 384, 3), 10: (256, 256, 3)},
        (64, 192, 384, 256, 256), "alexnet_features.pth", "lpips_lin_alex.pth",
    ),
}  # fmt: skip


def write_weights(folder: Path, network: str) -> tuple[Path, Path]:
    generator = torch.Generator().manual_seed(1)
    convolutions, channels, file, linear_file = LAYOUTS[network]
    features = {"classifier.6.bias": torch.zeros(1000)}
    for key, (outputs, inputs, kernel) in convolutions.items():
        spread = (2 / (inputs * kernel * kernel)) ** 0.5
        features[f"features.{key}.weight"] = torch.randn(outputs, inputs, kernel, kernel, generator=generator) * spread
        features[f"features.{key}.bias"] = 0.1 * torch.randn(outputs, generator=generator)
    linear = {f"lin{i}.model.1.weight": torch.rand(1, c, 1, 1, generator=generator) for i, c in enumerate(channels)}
    torch.save(features, folder / file)
    torch.save(linear, folder / linear_file)
    return folder / file, folder / linear_file


def synthetic_pair(size: int = 64, noise: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """Exact arithmetic makes the values equal on every machine."""
    y, x = np.mgrid[:size, :size]
    base = np.stack([(x * 7 + y * 3) % 64, (x * y) % 97, (x + 2 * y) % 50], axis=2) / 100
    other = base + noise * (((x * 31 + y * 17) % 23)[..., None] / 11 - 1)
    return tuple(np.clip(a, 0, 1).astype(np.float32)[None] for a in (base, other))


def plain_lpips(
    paths: tuple[Path, Path], network: str, a: np.ndarray, b: np.ndarray, *, normalize: bool = True
) -> float:
    """The published definition as a `Sequential` in torchvision's numbering, in float64.

    `normalize` has the meaning of the official package: True scales pictures from [0, 1] to [-1, 1].
    """
    weights, mixing = (torch.load(p, weights_only=True, map_location="cpu") for p in paths)
    convolutions = LAYOUTS[network][0]
    pools = {"vgg": (4, 9, 16, 23), "alex": (2, 5)}[network]
    taps = {"vgg": (3, 8, 15, 22, 29), "alex": (1, 4, 7, 9, 11)}[network]
    layers: list[torch.nn.Module] = []
    for i in range(taps[-1] + 1):
        if i in convolutions:
            out, into, kernel = convolutions[i]
            stride, padding = (4, 2) if kernel == 11 else (1, kernel // 2)
            layer = torch.nn.Conv2d(into, out, kernel, stride, padding).double()
            layer.weight.data = weights[f"features.{i}.weight"].double()
            layer.bias.data = weights[f"features.{i}.bias"].double()
        elif i in pools:
            layer = torch.nn.MaxPool2d(2 if network == "vgg" else 3, 2)
        else:
            layer = torch.nn.ReLU()
        layers.append(layer)
    shift = torch.tensor([-0.030, -0.088, -0.188]).double()
    scale = torch.tensor([0.458, 0.448, 0.450]).double()
    x = torch.stack([torch.from_numpy(t[0]).double() for t in (a, b)])
    x = (((2 * x - 1 if normalize else x) - shift) / scale).permute(0, 3, 1, 2)
    total = 0.0
    with torch.no_grad():
        for i, layer in enumerate(layers):
            x = layer(x)
            if i in taps:
                unit = x / (x.pow(2).sum(1, keepdim=True).sqrt() + 1e-10)
                weight = mixing[f"lin{taps.index(i)}.model.1.weight"].double()
                difference = (unit[:1] - unit[1:]) ** 2
                total += torch.nn.functional.conv2d(difference, weight).mean().item()
    return total


@pytest.mark.slow
@pytest.mark.parametrize("network", ["vgg", "alex"])
def test_lpips_equals_its_definition(tmp_path: Path, network: str) -> None:
    paths = write_weights(tmp_path, network)
    lpips = load_lpips(*paths, network)
    a, b = synthetic_pair(71)
    assert lpips(a, b).item() == pytest.approx(plain_lpips(paths, network, a, b), rel=1e-5)
    unscaled = plain_lpips(paths, network, a, b, normalize=False)
    assert lpips(a, b, scaled=False).item() == pytest.approx(unscaled, rel=1e-5)
    assert unscaled != pytest.approx(plain_lpips(paths, network, a, b), rel=0.01)
    assert lpips(a, a).item() == lpips(a, a, scaled=False).item() == 0
    noisier = [lpips(*synthetic_pair(71, n)).item() for n in (0.01, 0.05, 0.2)]
    assert noisier == sorted(noisier)
    both = lpips(np.concatenate([a, a]), np.concatenate([a, b]))
    assert both.tolist() == pytest.approx([0, lpips(a, b).item()], abs=1e-7)


def test_lpips_weights_are_found_by_folder_or_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DIR", "BACKBONE", "LINEAR"):
        monkeypatch.delenv(f"SPLATWIRE_LPIPS_{name}", raising=False)
    assert find_lpips() is None
    monkeypatch.setenv("SPLATWIRE_LPIPS_DIR", str(tmp_path))
    assert find_lpips("alex") is None
    backbone, linear = write_weights(tmp_path, "alex")
    assert isinstance(find_lpips("alex"), Lpips)
    assert find_lpips("vgg") is None
    monkeypatch.delenv("SPLATWIRE_LPIPS_DIR")
    monkeypatch.setenv("SPLATWIRE_LPIPS_BACKBONE", str(backbone))
    with pytest.raises(DatasetError, match="together"):
        find_lpips("alex")
    monkeypatch.setenv("SPLATWIRE_LPIPS_LINEAR", str(linear))
    assert isinstance(find_lpips("alex"), Lpips)
    with pytest.raises(
        DatasetError, match=r"alexnet_features.pth: 'features.0.weight' should have shape \(64, 3, 3, 3\)"
    ):
        find_lpips("vgg")


def test_invalid_weight_files_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    backbone, linear = write_weights(tmp_path, "alex")
    with pytest.raises(UnknownNameError, match="squeeze"):
        load_lpips(backbone, linear, "squeeze")
    with pytest.raises(DatasetError, match=r"nowhere\.pth"):
        load_lpips(tmp_path / "nowhere.pth", linear, "alex")
    linear.write_bytes(b"not a weight file")
    with pytest.raises(DatasetError, match=r"lpips_lin_alex\.pth"):
        load_lpips(backbone, linear, "alex")
    torch.save([1, 2], linear)
    with pytest.raises(DatasetError, match="holds a list"):
        load_lpips(backbone, linear, "alex")
    for old in (False, True):
        content = {"lin0.model.1.weight": bytearray(8)}
        torch.save(content, linear, _use_new_zipfile_serialization=not old)
        with pytest.raises(DatasetError, match="asks for __builtin__ bytearray"):
            load_lpips(backbone, linear, "alex")


def test_files_of_old_releases_of_pytorch_are_read(tmp_path: Path) -> None:
    backbone, linear = write_weights(tmp_path, "alex")
    new = load_lpips(backbone, linear, "alex")
    for path in (backbone, linear):
        torch.save(torch.load(path, weights_only=True), path, _use_new_zipfile_serialization=False)
    assert all(map(np.array_equal, load_lpips(backbone, linear, "alex").linear, new.linear))


@pytest.mark.data
def test_real_weights_give_pinned_values(data_dir: Path) -> None:
    folder = data_dir / "lpips"
    paths = (folder / "vgg16_features.pth", folder / "lpips_lin_vgg.pth")
    if not all(p.exists() for p in paths):
        pytest.skip(f"no LPIPS weights in {folder}")
    lpips = load_lpips(*paths)
    a, b = synthetic_pair()
    assert lpips(a, a).item() == 0
    assert lpips(a, b).item() == pytest.approx(plain_lpips(paths, "vgg", a, b), rel=1e-5)
    assert lpips(a, b).item() == pytest.approx(0.0869485, rel=1e-4)
    field = plain_lpips(paths, "vgg", a, b, normalize=False)
    assert lpips(a, b, scaled=False).item() == pytest.approx(field, rel=1e-5)
