"""The compiled heads against the plain ones."""

import dataclasses
import hashlib
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from close import assert_close
from scenes import tiny_cameras, tiny_scene
from splatwire.metrics import psnr
from splatwire.model import AnchorScene, GaussianHeads, Linear, Mlp, RenderHints
from splatwire.model.compiled_heads import drawn_gaussians
from splatwire.model.gaussian_heads import generate_gaussians
from splatwire.model.tensors import to_tensors
from splatwire.ops import threads as ops_threads
from splatwire.ops.arrays import to_arrays
from splatwire.render.reference import render_reference
from splatwire.scene import Cameras, Gaussians

NUM = 3000
FIELDS = ("means", "quats", "scales", "opacities", "colors")


def network(seed: int, width: int, outputs: int, slope: float = 0.0) -> Mlp:
    g = torch.Generator().manual_seed(seed)
    hidden = Linear(torch.randn(width, 16, generator=g) / 4, torch.randn(width, generator=g))
    return Mlp(hidden, Linear(torch.randn(outputs, width, generator=g) / 3, torch.randn(outputs, generator=g)), slope)


def make_scene(hints: RenderHints | None = None) -> AnchorScene:
    """Some of the anchors out of view; networks of three widths, none a multiple of what the kernel likes."""
    scene = tiny_scene(num_anchors=NUM)
    heads = GaussianHeads(network(1, 13, 4), network(2, 22, 28, 0.01), network(3, 7, 12))
    return dataclasses.replace(scene, heads=to_arrays(heads), hints=hints)


def make_hints() -> RenderHints:
    g = torch.Generator().manual_seed(5)
    gains = [3 * torch.rand(NUM, generator=g) for _ in range(2)]
    return to_arrays(RenderHints(gains[0], torch.rand(NUM, generator=g) < 0.3, gains[1]))


def make_cameras() -> Cameras:
    return tiny_cameras(2, 80, 60, distance=1.0)


def visible(gaussians: Gaussians) -> list[torch.Tensor]:
    return [getattr(gaussians, name)[gaussians.opacities >= 1 / 255] for name in FIELDS]


@pytest.mark.parametrize("hints", [None, make_hints(), dataclasses.replace(make_hints(), opacity_gain=None)])
@pytest.mark.parametrize("view", [0, 1])
def test_they_spawn_the_same_gaussians(view: int, hints: RenderHints | None) -> None:
    scene = make_scene(hints)
    plain = generate_gaussians(scene, make_cameras(), view)
    drawn = drawn_gaussians(scene, make_cameras(), view)
    assert (
        1000 < drawn.num_gaussians < plain.num_gaussians < 4 * NUM
    )  # faint ones are left out, and what is not in view
    for actual, expected in zip([getattr(drawn, name) for name in FIELDS], visible(plain), strict=True):
        assert_close(actual, expected, rtol=1e-4, atol=2e-6)


def test_pictures_are_the_plain_ones() -> None:
    """At least 60 dB; faint Gaussians and rounding make up the rest."""
    scene, cameras, black = make_scene(), make_cameras(), torch.zeros(3)
    for view in range(2):
        one = cameras.select([view])
        pictures = [
            render_reference(to_tensors(f(scene, one, 0)), to_tensors(one), background=black)
            for f in (drawn_gaussians, generate_gaussians)
        ]
        assert pictures[1].max() > 0.5
        assert psnr(*pictures).item() > 60


@pytest.mark.parametrize("num", [0, 1, 15, 1030])
def test_any_number_of_anchors(num: int) -> None:
    whole = make_scene()
    fields = {f.name: getattr(whole.anchors, f.name)[:num] for f in dataclasses.fields(whole.anchors)}
    scene = dataclasses.replace(whole, anchors=type(whole.anchors)(**fields))
    expected = visible(generate_gaussians(scene, make_cameras(), 0))[0]
    assert_close(drawn_gaussians(scene, make_cameras(), 0).means, expected)


def test_numbers_that_are_none_are_not_drawn_or_stay_where_they_are() -> None:
    """An anchor beyond all numbers spoils none of the fifteen that share its lanes."""
    scene = make_scene()
    features = scene.anchors.features.copy()
    features[100], features[101] = math.nan, math.inf
    spoilt = dataclasses.replace(scene, anchors=dataclasses.replace(scene.anchors, features=features))
    hints = RenderHints(np.ones(NUM, np.float32), np.arange(NUM) // 2 == 50)
    clean = drawn_gaussians(dataclasses.replace(scene, hints=hints), make_cameras(), 0)
    drawn = drawn_gaussians(spoilt, make_cameras(), 0)
    rows = [getattr(drawn, name).reshape(drawn.num_gaussians, -1) for name in FIELDS]
    finite = np.logical_and.reduce([np.isfinite(values).all(axis=1) for values in rows])
    others = np.isin(drawn.means.ravel(), clean.means.ravel()).reshape(-1, 3).all(axis=1) & finite
    assert int(others.sum()) == clean.num_gaussians


def test_shapes_that_do_not_fit_are_refused() -> None:
    scene = make_scene()
    short = RenderHints(np.ones(NUM - 1, np.float32), np.zeros(NUM - 1, np.bool_))
    with pytest.raises(ValueError, match="hints of"):
        drawn_gaussians(dataclasses.replace(scene, hints=short), make_cameras(), 0)
    heads = dataclasses.replace(scene.heads, color=to_arrays(network(3, 7, 11)))
    with pytest.raises(ValueError, match="12 outputs"):
        drawn_gaussians(dataclasses.replace(scene, heads=heads), make_cameras(), 0)


def digest(gaussians: Gaussians) -> str:
    return hashlib.sha256(b"".join(getattr(gaussians, name).tobytes() for name in FIELDS)).hexdigest()


def test_the_same_bits_with_any_threads_and_in_a_process_that_compiles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = []
    for threads in (1, 2):
        monkeypatch.setattr(ops_threads, "allowed_threads", lambda threads=threads: threads)
        found.append(digest(drawn_gaussians(make_scene(make_hints()), make_cameras(), 0)))
    drawn = "t.drawn_gaussians(t.make_scene(t.make_hints()), t.make_cameras(), 0)"
    script = f"import test_compiled_heads as t; print(t.digest({drawn}))"
    here = Path(__file__).parent
    paths = [str(here), str(here.parent), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": os.pathsep.join(paths)}
    for _ in range(2):  # the second one finds what the first one compiled
        answer = subprocess.run(
            [sys.executable, "-c", script], env=environment, capture_output=True, text=True, timeout=300
        )
        assert answer.stderr == ""
        found.append(answer.stdout.strip())
    assert any(tmp_path.rglob("*.nbc")), "nothing was compiled"
    assert len(set(found)) == 1
