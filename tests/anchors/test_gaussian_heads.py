"""The heads against a loop that follows the specification, and the effects of hints."""

import dataclasses
import math

import pytest
import torch

from splatwire.neural.model.gaussian_heads import generate_gaussians, spawn_gaussians, visible_anchors
from splatwire.types import Anchors, Cameras, GaussianHeads, HacppCoding, Linear, Mlp, RenderHints

F, K, N = 6, 3, 40
WIDTH, HEIGHT = 50, 35


def rand(seed: int, *shape: int) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def make_anchors() -> Anchors:
    positions = rand(0, N, 3) * 2 + torch.tensor([0.0, 0.0, 3.0])
    mask = rand(4, N, K) > -0.5
    mask[5] = False
    return Anchors(positions, rand(1, N, F), 0.01 + 0.1 * rand(2, N, 6).abs(), rand(3, N, K, 3), mask)


def make_heads() -> GaussianHeads:
    def mlp(seed: int, outputs: int) -> Mlp:
        return Mlp(
            Linear(rand(seed, 8, F + 4), rand(seed + 1, 8)), Linear(rand(seed + 2, outputs, 8), rand(seed + 3, outputs))
        )

    return GaussianHeads(mlp(10, K), mlp(20, 7 * K), mlp(30, 3 * K))


def make_cameras() -> Cameras:
    pose = torch.eye(4)
    c, s = math.cos(0.3), math.sin(0.3)
    pose[:3, :3] = torch.tensor([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    pose[:3, 3] = torch.tensor([0.1, 0.2, 0.3])
    intrinsics = torch.tensor([[60.0, 0, WIDTH / 2], [0, 55.0, HEIGHT / 2], [0, 0, 1]])
    return Cameras(torch.stack([torch.eye(4), pose]), intrinsics.repeat(2, 1, 1), WIDTH, HEIGHT, ("a", "b"))


def make_scene(hints: RenderHints | None = None):  # type: ignore[no-untyped-def]
    """Scene without a context model, which rendering does not use."""
    from splatwire.types import AnchorScene, HacppConfig, HacppContextModel, HashGrid

    heads = make_heads()
    table = torch.ones(1, 1, dtype=torch.int8)
    grid = HashGrid(table, table[None].repeat(3, 1, 1), torch.zeros(3), torch.ones(3))
    return AnchorScene(
        make_anchors(), heads, HacppCoding(HacppContextModel(grid, heads.opacity, ()), 0.01, HacppConfig()), hints
    )


def run(mlp: Mlp, x: list[float]) -> list[float]:
    def layer(linear: Linear, values: list[float]) -> list[float]:
        rows = zip(linear.weight.tolist(), linear.bias.tolist(), strict=True)
        return [sum(w * v for w, v in zip(row, values, strict=True)) + b for row, b in rows]

    return layer(mlp.output, [max(0.0, h) for h in layer(mlp.hidden, x)])


def expected_gaussians(view: int) -> list[tuple[float, ...]]:
    """HAC++'s decoding of a view in scalars: one row of centre, scale, quaternion, opacity, colour per Gaussian."""
    anchors, heads, cameras = make_anchors(), make_heads(), make_cameras()
    pose, K_ = cameras.viewmats[view].tolist(), cameras.Ks[view].tolist()
    center = [-sum(pose[i][j] * pose[i][3] for i in range(3)) for j in range(3)]
    rows = []
    for n in range(N):
        p, size = anchors.positions[n].tolist(), anchors.scalings[n].tolist()
        x, y, z = (sum(pose[i][j] * p[j] for j in range(3)) + pose[i][3] for i in range(3))
        if z <= 0.2:
            continue
        fx, fy = K_[0][0], K_[1][1]
        lim_x, lim_y = 1.3 * WIDTH / (2 * fx), 1.3 * HEIGHT / (2 * fy)
        tx, ty = min(max(x / z, -lim_x), lim_x), min(max(y / z, -lim_y), lim_y)
        jx = [fx / z * (pose[0][j] - tx * pose[2][j]) * size[j] for j in range(3)]
        jy = [fy / z * (pose[1][j] - ty * pose[2][j]) * size[j] for j in range(3)]
        a, b, c = (sum(u * v for u, v in zip(s, t, strict=True)) for s, t in ((jx, jx), (jx, jy), (jy, jy)))
        a, c = a + 0.3, c + 0.3
        mid = (a + c) / 2
        radius = math.ceil(3 * math.sqrt(mid + math.sqrt(max(0.1, mid * mid - (a * c - b * b)))))
        u = ((2 * fx / WIDTH * x / z + 1) * WIDTH - 1) / 2
        v = ((2 * fy / HEIGHT * y / z + 1) * HEIGHT - 1) / 2
        tiles = [(int(max((m - radius) / 16, 0)), min(int(max((m + radius + 15) / 16, 0)), -(-s // 16)))
                 for m, s in ((u, WIDTH), (v, HEIGHT))]  # fmt: skip
        if any(high <= low for low, high in tiles):
            continue
        ray = [p[j] - center[j] for j in range(3)]
        dist = math.sqrt(sum(r * r for r in ray))
        inputs = [*anchors.features[n].tolist(), *(r / dist for r in ray), dist]
        opacity, cov, color = run(heads.opacity, inputs), run(heads.covariance, inputs), run(heads.color, inputs)
        for k in range(K):
            if math.tanh(opacity[k]) <= 0 or not anchors.mask[n, k]:
                continue
            mean = [p[j] + anchors.offsets[n, k, j].item() * size[j] for j in range(3)]
            scale = [size[3 + j] / (1 + math.exp(-cov[7 * k + j])) for j in range(3)]
            quat = cov[7 * k + 3 : 7 * k + 7]
            norm = math.sqrt(sum(q * q for q in quat))
            rgb = [1 / (1 + math.exp(-color[3 * k + j])) for j in range(3)]
            rows.append((*mean, *scale, *(q / norm for q in quat), math.tanh(opacity[k]), *rgb))
    return rows


@pytest.mark.parametrize("view", [0, 1])
def test_gaussian_heads_match_the_specification(view: int) -> None:
    g = generate_gaussians(make_scene(), make_cameras(), view)
    actual = torch.cat([g.means, g.scales, g.quats, g.opacities[:, None], g.colors], dim=1)
    expected = torch.tensor(expected_gaussians(view))
    assert 10 < expected.shape[0] < N * K
    assert actual.shape == expected.shape
    assert torch.allclose(actual, expected, rtol=1e-4, atol=1e-5)


def test_left_out_anchors_are_not_drawn() -> None:
    left_out = rand(40, N) > 0
    whole = spawn_gaussians(
        make_anchors(), make_heads(), torch.zeros(3), visible_anchors(make_anchors(), make_cameras(), 0)
    )
    hinted = generate_gaussians(make_scene(RenderHints(torch.ones(N), left_out)), make_cameras(), 0)
    kept = ~left_out[whole.anchor_index]
    assert 0 < kept.sum() < len(kept)
    assert torch.equal(hinted.means, whole.gaussians.means[kept])


def test_size_gain_scales_gaussians_and_nothing_else() -> None:
    gain = 1 + rand(41, N).abs()
    plain = generate_gaussians(make_scene(), make_cameras(), 0)
    hinted = generate_gaussians(make_scene(RenderHints(gain, torch.zeros(N, dtype=torch.bool))), make_cameras(), 0)
    index = spawn_gaussians(
        make_anchors(), make_heads(), torch.zeros(3), visible_anchors(make_anchors(), make_cameras(), 0)
    ).anchor_index
    assert torch.allclose(hinted.scales, plain.scales * gain[index, None])
    for name in ("means", "quats", "opacities", "colors"):
        assert torch.equal(getattr(hinted, name), getattr(plain, name))


def test_opacity_gain_scales_opacities_up_to_1_and_nothing_else() -> None:
    gain = 3 * rand(42, N).abs()
    plain = generate_gaussians(make_scene(), make_cameras(), 0)
    hints = RenderHints(torch.ones(N), torch.zeros(N, dtype=torch.bool), gain)
    hinted = generate_gaussians(make_scene(hints), make_cameras(), 0)
    visible = visible_anchors(make_anchors(), make_cameras(), 0)
    index = spawn_gaussians(make_anchors(), make_heads(), torch.zeros(3), visible).anchor_index
    wanted = plain.opacities * gain[index]
    assert bool((wanted > 1).any())
    assert torch.equal(hinted.opacities, wanted.clamp(max=1))
    for name in ("means", "quats", "scales", "colors"):
        assert torch.equal(getattr(hinted, name), getattr(plain, name))


def test_indices_map_gaussians_to_anchors() -> None:
    anchors = make_anchors()
    visible = torch.ones(N, dtype=torch.bool)
    spawned = spawn_gaussians(anchors, make_heads(), torch.tensor([0.0, 0.0, -9.0]), visible)
    offset = anchors.offsets[spawned.anchor_index, spawned.offset_index]
    expected = anchors.positions[spawned.anchor_index] + offset * anchors.scalings[spawned.anchor_index, :3]
    assert torch.equal(spawned.gaussians.means, expected)
    flat = spawned.anchor_index * K + spawned.offset_index
    assert (flat.diff() > 0).all()


def test_mask_weight_multiplies_opacity_and_scale_and_gets_a_gradient() -> None:
    anchors, heads, visible = make_anchors(), make_heads(), torch.ones(N, dtype=torch.bool)
    weight = torch.full((N, K), 0.5, requires_grad=True)
    center = torch.tensor([0.0, 0.0, -9.0])
    plain = spawn_gaussians(anchors, heads, center, visible).gaussians
    halved = spawn_gaussians(anchors, heads, center, visible, mask_weight=weight).gaussians
    assert torch.allclose(halved.opacities, 0.5 * plain.opacities)
    assert torch.allclose(halved.scales, 0.5 * plain.scales)
    (halved.opacities.sum() + halved.scales.sum()).backward()
    assert weight.grad is not None
    assert (weight.grad != 0).sum() == plain.num_gaussians


def test_gradients_reach_attributes_and_networks() -> None:
    """Against central differences in float64, for one weight of each kind."""
    scene = make_scene()
    double = {f.name: getattr(scene.anchors, f.name) for f in dataclasses.fields(Anchors)}
    double = {k: v.double() if v.is_floating_point() else v for k, v in double.items()}
    leaves = [double[name].requires_grad_() for name in ("features", "scalings", "offsets")]
    heads = make_heads()
    heads = GaussianHeads(*[
        Mlp(*[Linear(x.weight.double().requires_grad_(), x.bias.double()) for x in (m.hidden, m.output)])
        for m in (heads.opacity, heads.covariance, heads.color)
    ])  # fmt: skip
    leaves += [heads.opacity.hidden.weight, heads.covariance.output.weight, heads.color.hidden.weight]
    visible = visible_anchors(scene.anchors, make_cameras(), 0)

    def loss() -> torch.Tensor:
        g = spawn_gaussians(Anchors(**double), heads, torch.zeros(3, dtype=torch.float64), visible).gaussians
        parts = (g.means, g.scales, g.quats, g.opacities, g.colors)
        return sum(((i + 1) * p * torch.linspace(0, 1, p.numel()).view_as(p)).sum() for i, p in enumerate(parts))

    gradients = torch.autograd.grad(loss(), leaves)
    for leaf, gradient in zip(leaves, gradients, strict=True):
        at = int(gradient.abs().argmax())
        with torch.no_grad():
            values = []
            for step in (1e-6, -1e-6):
                leaf.view(-1)[at] += step
                values.append(float(loss()))
                leaf.view(-1)[at] -= step
        assert gradient.view(-1)[at].item() == pytest.approx((values[0] - values[1]) / 2e-6, rel=1e-4)


def test_view_without_anchors_has_no_gaussians() -> None:
    cameras = make_cameras()
    away = Cameras(torch.diag(torch.tensor([1.0, -1, -1, 1]))[None], cameras.Ks[:1], WIDTH, HEIGHT, ("away",))
    scene = make_scene()
    front = dataclasses.replace(scene.anchors, positions=scene.anchors.positions.abs() + 0.5)
    assert generate_gaussians(dataclasses.replace(scene, anchors=front), away, 0).num_gaussians == 0
