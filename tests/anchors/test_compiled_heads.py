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

from close import assert_close
from random_numbers import Numbers
from scenes import tiny_cameras, tiny_scene
from splatwire.anchors.compiled_heads import drawn_gaussians
from splatwire.anchors.head_gradients import Spawning, visible_anchors
from splatwire.metrics import psnr
from splatwire.ops import threads as ops_threads
from splatwire.render.cpu import render_cpu
from splatwire.types import AnchorScene, Cameras, GaussianHeads, Gaussians, Linear, Mlp, RenderHints

NUM = 3000
FIELDS = ("means", "quats", "scales", "opacities", "colors")


def network(seed: int, width: int, outputs: int, slope: float = 0.0) -> Mlp:
    g = Numbers(seed)
    hidden = Linear(g.randn(width, 16) / 4, g.randn(width))
    return Mlp(hidden, Linear(g.randn(outputs, width) / 3, g.randn(outputs)), slope)


def make_scene(hints: RenderHints | None = None) -> AnchorScene:
    """Scene with anchors out of view and networks of three widths that are no multiple of the lane count."""
    scene = tiny_scene(num_anchors=NUM)
    heads = GaussianHeads(network(1, 13, 4), network(2, 22, 28, 0.01), network(3, 7, 12))
    return dataclasses.replace(scene, heads=heads, hints=hints)


def make_hints() -> RenderHints:
    g = Numbers(5)
    gains = [3 * g.rand(NUM) for _ in range(2)]
    return RenderHints(gains[0], g.rand(NUM) < 0.3, gains[1])


def make_cameras() -> Cameras:
    return tiny_cameras(2, 80, 60, distance=1.0)


def generate_gaussians(scene: AnchorScene, cameras: Cameras, view: int) -> Gaussians:
    """Gaussians of a view computed in plain numpy, also those too faint to be drawn."""
    anchors, hints = scene.anchors, scene.hints
    seen = visible_anchors(anchors, cameras, view)
    rows = np.flatnonzero(seen if hints is None else seen & ~hints.left_out)
    spawned = Spawning(anchors.select(rows), scene.heads, cameras.centers[view].astype(np.float32))
    drawn, anchor = spawned.gaussians, rows[spawned.anchor_index]
    if hints is None:
        return drawn
    opacities = drawn.opacities if hints.opacity_gain is None else drawn.opacities * hints.opacity_gain[anchor]
    scales = drawn.scales * hints.size_gain[anchor, None]
    return dataclasses.replace(drawn, scales=scales, opacities=np.minimum(opacities, 1))


def visible(gaussians: Gaussians) -> list[np.ndarray]:
    return [getattr(gaussians, name)[gaussians.opacities >= 1 / 255] for name in FIELDS]


@pytest.mark.parametrize("hints", [None, make_hints(), dataclasses.replace(make_hints(), opacity_gain=None)])
@pytest.mark.parametrize("view", [0, 1])
def test_compiled_heads_spawn_the_same_gaussians(view: int, hints: RenderHints | None) -> None:
    scene = make_scene(hints)
    plain = generate_gaussians(scene, make_cameras(), view)
    drawn = drawn_gaussians(scene, make_cameras(), view)
    assert (
        1000 < drawn.num_gaussians < plain.num_gaussians < 4 * NUM
    )  # faint Gaussians and those out of view are left out
    for actual, expected in zip([getattr(drawn, name) for name in FIELDS], visible(plain), strict=True):
        assert_close(actual, expected, rtol=1e-4, atol=2e-6)


@pytest.mark.parametrize("near_depth", [0.01, 0.6])
def test_compiled_heads_leave_out_what_is_before_the_near_plane(near_depth: float) -> None:
    scene, cameras = make_scene(), make_cameras()
    moved = dataclasses.replace(cameras, near_depth=near_depth)
    drawn = drawn_gaussians(scene, moved, 0)
    assert drawn.num_gaussians != drawn_gaussians(scene, cameras, 0).num_gaussians
    assert_close(drawn.means, visible(generate_gaussians(scene, moved, 0))[0], rtol=1e-4, atol=2e-6)


@pytest.mark.slow
def test_compiled_heads_render_the_same_pictures() -> None:
    """PSNR is at least 60 dB; faint Gaussians and rounding explain the difference."""
    scene, cameras, black = make_scene(), make_cameras(), np.zeros(3, np.float32)
    for view in range(2):
        one = cameras.select([view])
        pictures = [render_cpu(f(scene, one, 0), one, background=black) for f in (drawn_gaussians, generate_gaussians)]
        assert pictures[1].max() > 0.5
        assert psnr(*pictures).item() > 60


@pytest.mark.parametrize("num", [0, 1, 15, 1030])
def test_compiled_heads_accept_any_number_of_anchors(num: int) -> None:
    whole = make_scene()
    fields = {f.name: getattr(whole.anchors, f.name)[:num] for f in dataclasses.fields(whole.anchors)}
    scene = dataclasses.replace(whole, anchors=type(whole.anchors)(**fields))
    expected = visible(generate_gaussians(scene, make_cameras(), 0))[0]
    assert_close(drawn_gaussians(scene, make_cameras(), 0).means, expected)


def test_non_finite_anchors_do_not_affect_others() -> None:
    """A non-finite anchor does not affect the fifteen others in its lanes."""
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


def test_inconsistent_shapes_are_refused() -> None:
    scene = make_scene()
    short = RenderHints(np.ones(NUM - 1, np.float32), np.zeros(NUM - 1, np.bool_))
    with pytest.raises(ValueError, match=r"hints\.size_gain is for 2,999 elements"):
        drawn_gaussians(dataclasses.replace(scene, hints=short), make_cameras(), 0)
    heads = dataclasses.replace(scene.heads, color=network(3, 7, 11))
    with pytest.raises(ValueError, match="12 outputs"):
        drawn_gaussians(dataclasses.replace(scene, heads=heads), make_cameras(), 0)


def digest(gaussians: Gaussians) -> str:
    return hashlib.sha256(b"".join(getattr(gaussians, name).tobytes() for name in FIELDS)).hexdigest()


def test_result_is_bit_identical_for_any_thread_count(monkeypatch: pytest.MonkeyPatch) -> None:
    found = []
    for threads in (1, 2):
        monkeypatch.setattr(ops_threads, "allowed_threads", lambda threads=threads: threads)
        found.append(digest(drawn_gaussians(make_scene(make_hints()), make_cameras(), 0)))
    assert found[0] == found[1]


@pytest.mark.slow
@pytest.mark.extended
def test_freshly_compiled_kernels_give_bit_identical_results(tmp_path: Path) -> None:
    found = [digest(drawn_gaussians(make_scene(make_hints()), make_cameras(), 0))]
    drawn = "t.drawn_gaussians(t.make_scene(t.make_hints()), t.make_cameras(), 0)"
    script = f"import test_compiled_heads as t; print(t.digest({drawn}))"
    here = Path(__file__).parent
    paths = [str(here), str(here.parent), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": os.pathsep.join(paths)}
    for _ in range(2):  # the second process finds the kernels of the first
        answer = subprocess.run(
            [sys.executable, "-c", script], env=environment, capture_output=True, text=True, timeout=300
        )
        assert answer.stderr == ""
        found.append(answer.stdout.strip())
    assert any(tmp_path.rglob("*.nbc")), "nothing was compiled"
    assert len(set(found)) == 1
