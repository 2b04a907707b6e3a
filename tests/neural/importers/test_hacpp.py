import builtins
import io
import json
import lzma
import os
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch

from reference.float_prior import channel_parameters
from splatwire.anchors.voxels import voxel_indices
from splatwire.errors import DatasetError
from splatwire.neural.importers._hacpp_files import infer_voxel_size
from splatwire.neural.importers.hacpp import import_hacpp
from splatwire.neural.model.prior_field import split_prior_outputs
from splatwire.neural.model.tensors import to_tensors

DATA = Path(os.environ.get("SPLATWIRE_DATA", Path(__file__).parents[3] / ".." / "shared" / "data")) / "hacpp"


def assert_anchors(anchors, model, kept=slice(None)):
    assert np.array_equal(voxel_indices(anchors.positions, 0.02), model.voxels[kept])
    assert np.array_equal(anchors.features, model.features[kept])
    assert np.array_equal(anchors.mask, model.mask[kept])
    assert np.array_equal(anchors.offsets, (model.offsets * model.mask[:, :, None])[kept])


def test_decoded_model_is_imported_unchanged(model):
    scene = import_hacpp(model.write())
    assert_anchors(scene.anchors, model)
    assert np.array_equal(scene.anchors.scalings, model.scalings)
    assert scene.coding.voxel_size == 0.02
    layout, anchors = scene.coding.config.layout, scene.anchors
    assert (anchors.features.shape[1], anchors.mask.shape[1]) == (layout.feature_dim, layout.num_offsets)
    assert scene.coding.config.layout.feature_groups == (2, 3)
    assert scene.coding.config.base_steps == (1.0, 0.001, 0.2)


def test_grid_and_networks_come_from_the_checkpoint(model):
    scene = import_hacpp(model.write())
    grid, state = scene.coding.context_model.grid, model.checkpoint["encoding_xyz"]
    assert np.array_equal(grid.volume, np.where(state["encoding_xyz.params"].numpy() >= 0, 1, -1))
    for i, plane in enumerate(("xy", "xz", "yz")):
        assert np.array_equal(grid.planes[i], np.where(state[f"encoding_{plane}.params"].numpy() >= 0, 1, -1))
    assert grid.volume[0, 0] == 1  # zero counts as +1
    assert np.array_equal(grid.bounds_min, model.bounds[0][0])
    assert np.array_equal(grid.bounds_max, model.bounds[1][0])
    shape = scene.coding.config.grid
    assert (shape.resolutions_3d, shape.resolutions_2d) == ((4, 9), (5, 17))
    assert (shape.rows(3), shape.rows(2)) == ((64, 128), (32, 128))
    for network, key in (
        (scene.heads.opacity, "opacity_mlp"),
        (scene.heads.covariance, "cov_mlp"),
        (scene.heads.color, "color_mlp"),
        (scene.coding.context_model.prior, "grid_mlp"),
    ):
        assert np.array_equal(network.hidden.weight, model.checkpoint[key]["0.weight"])
        assert np.array_equal(network.output.bias, model.checkpoint[key]["2.bias"])
        assert network.negative_slope == 0
    for i, network in enumerate(scene.coding.context_model.channel):
        assert np.array_equal(network.output.weight, model.checkpoint["deform_mlp"][f"MLP_d{i}.2.weight"])
        assert network.negative_slope == 0.01


def undecoded(model):
    """The model as HAC++ saves it before decoding: logarithms of scalings, and mask logits (sigmoid above 0.01)."""
    columns = model.columns()
    for i in range(6):
        columns[f"scale_{i}"] = np.log(model.scalings[:, i] + np.float32(0.01))
    for k in range(2):
        columns[f"f_mask_{k}"] = np.where(model.mask[:, k], -4.59, -4.6)  # logit(0.01) = -4.5951
    columns["f_mask_2"] = np.ones(9)
    return columns


def test_undecoded_model_is_activated_and_pruned(model):
    model.mask[4] = False
    scene = import_hacpp(model.write(undecoded(model)))
    kept = [0, 1, 2, 3, 5, 6, 7, 8]
    assert_anchors(scene.anchors, model, kept)
    np.testing.assert_allclose(scene.anchors.scalings, model.scalings[kept] + 0.01, rtol=1e-6)


def test_untrained_mask_logits_are_not_read_as_a_decoded_mask(model):
    columns = undecoded(model)
    for k in range(3):
        columns[f"f_mask_{k}"] = np.ones(9)
    scene = import_hacpp(model.write(columns))
    assert scene.anchors.mask.all()
    np.testing.assert_allclose(scene.anchors.scalings, model.scalings + 0.01, rtol=1e-6)


def test_newest_iteration_is_chosen_by_number(model):
    model.write()
    for name in ("iteration_90", "iteration_junk"):
        shutil.copytree(model.iteration, model.iteration.with_name(name))
        (model.iteration.with_name(name) / "checkpoint.pth").unlink()
    assert import_hacpp(model.root).anchors.num_anchors == 9


def test_a_packed_ply_is_read(model):
    model.write()
    ply = model.iteration / "point_cloud.ply"
    ply.with_name("point_cloud.ply.xz").write_bytes(lzma.compress(ply.read_bytes()))
    ply.unlink()
    assert_anchors(import_hacpp(model.root).anchors, model)


@pytest.mark.parametrize("source", ["metrics.json", "cfg_args", "inferred"])
def test_voxel_size_is_read_from_other_sources(model, source):
    model.write()
    (model.root / "bitstreams" / "xyz_gpcc.npz").unlink()
    if source == "metrics.json":
        (model.root / source).write_text(json.dumps({"voxel_size": 0.02}))
    elif source == "cfg_args":
        (model.root / source).write_text("Namespace(update_depth=3, voxel_size=0.02, white_background=False)")
    scene = import_hacpp(model.root)
    assert scene.coding.voxel_size == 0.02
    assert_anchors(scene.anchors, model)


@pytest.mark.parametrize(
    ("arguments", "color"), [("", 0.0), (", white_background=False", 0.0), (", white_background=True", 1.0)]
)
def test_background_equals_that_of_the_training(model, arguments, color):
    model.write()
    assert import_hacpp(model.root).background == (0.0, 0.0, 0.0)
    (model.root / "cfg_args").write_text(f"Namespace(eval=True{arguments}, voxel_size=0.02)")
    assert import_hacpp(model.root).background == (color,) * 3


@pytest.mark.parametrize("voxel_size", [0.001, 0.01, 0.005, 0.012345678901234])
def test_voxel_size_is_inferred_from_positions(voxel_size):
    voxels = np.random.default_rng(0).integers(-3000, 9000, (3000, 3)).astype(np.float32)
    assert infer_voxel_size(voxels * np.float32(voxel_size)) == pytest.approx(voxel_size, rel=1e-7)


def test_the_tiny_channel_context_ignores_the_prior(model, tiny_deform_checkpoint):
    model.checkpoint = tiny_deform_checkpoint
    scene = import_hacpp(model.write())
    outputs = split_prior_outputs(torch.randn(4, 42, generator=torch.Generator().manual_seed(1)), scene.coding.config)
    context = to_tensors(scene.coding.context_model)
    first = channel_parameters(context, 0, torch.zeros(4, 0), outputs)
    free = tiny_deform_checkpoint["deform_mlp"]["MLP_d0"].view(3, 2)
    assert torch.equal(first.mean, free[0].expand(4, 2))
    assert torch.equal(first.weight, free[2].expand(4, 2))
    decoded = torch.randn(4, 2, generator=torch.Generator().manual_seed(2))
    second = channel_parameters(context, 1, decoded, outputs)
    weights = [
        tiny_deform_checkpoint["deform_mlp"][f"MLP_d1.{n}"].numpy()
        for n in ("0.weight", "0.bias", "2.weight", "2.bias")
    ]
    hidden = decoded.numpy() @ weights[0].T + weights[1]
    expected = np.where(hidden > 0, hidden, 0.01 * hidden) @ weights[2].T + weights[3]
    np.testing.assert_allclose(second.mean.numpy(), expected[:, :3], atol=1e-5)


def edit_checkpoint(change):
    def apply(model):
        change(model.checkpoint)
        model.write()

    return apply


def edit_file(name, content):
    def apply(model):
        model.write()
        path = model.root / name
        path.unlink() if content is None else path.write_bytes(content)

    return apply


def edit_bounds(low):
    def apply(model):
        model.bounds = np.float32([low]), model.bounds[1]
        model.write()

    return apply


def edit_column(name, value):
    def apply(model):
        columns = model.columns()
        if value is None:
            del columns[name]
        else:
            columns[name] = np.full(9, value)
        model.write(columns)

    return apply


CHECKPOINT = "point_cloud/iteration_300/checkpoint.pth"
PLY = "point_cloud/iteration_300/point_cloud.ply"
BAD = {
    "no folder": (lambda model: None, "no such file or folder"),
    "wrong folder": (lambda model: model.root.mkdir(), "not a model folder"),
    "no ply": (edit_file(PLY, None), "neither point_cloud.ply nor"),
    "no checkpoint": (edit_file(CHECKPOINT, None), "checkpoint.pth: missing"),
    "no bounds": (edit_file("bitstreams/x_bound_max.pkl", None), "x_bound_max.pkl: missing"),
    "noise as checkpoint": (edit_file(CHECKPOINT, b"\1" * 99), "checkpoint.pth: not a readable"),
    "noise as bounds": (
        edit_file("bitstreams/x_bound_min.pkl", b"PK\3\4" + b"\1" * 99),
        "x_bound_min.pkl: not a readable",
    ),
    "noise as voxel size": (
        edit_file("bitstreams/xyz_gpcc.npz", b"PK\3\4" + b"\1" * 99),
        "xyz_gpcc.npz: no voxel size",
    ),
    "no network": (edit_checkpoint(lambda c: c.pop("grid_mlp")), "has no 'grid_mlp'"),
    "feature bank": (edit_checkpoint(lambda c: c.update(mlp_feature_bank={})), "'mlp_feature_bank', which is not part"),
    "nan weight": (
        edit_checkpoint(lambda c: c["cov_mlp"]["2.bias"].fill_(np.nan)),
        "'cov_mlp' / '2.bias' is not a tensor of finite",
    ),
    "stride of 0": (
        edit_checkpoint(lambda c: c["cov_mlp"].update({"2.bias": torch.zeros(1).expand(1 << 40)})),
        "'cov_mlp' / '2.bias' is not a tensor of finite",
    ),
    "wide head": (
        edit_checkpoint(lambda c: c["color_mlp"].update({"2.bias": torch.zeros(9)})),
        "'color_mlp' / '2.bias' has shape \\(9,\\), expected \\(6,\\)",
    ),
    "no layer": (edit_checkpoint(lambda c: c["opacity_mlp"].pop("0.bias")), "'opacity_mlp' has no '0.bias'"),
    "short table": (
        edit_checkpoint(lambda c: c["encoding_xyz"].update({"encoding_xy.params": torch.ones(9, 2)})),
        "'encoding_xy' has 9 rows",
    ),
    "odd rows": (
        edit_checkpoint(lambda c: c["encoding_xyz"]["encoding_xyz.offsets_list"].add_(1).mul_(2)),
        "which no table size gives",
    ),
    "no channel context": (edit_checkpoint(lambda c: c["deform_mlp"].clear()), "no networks MLP_d0"),
    "gap in groups": (edit_checkpoint(lambda c: c["deform_mlp"].pop("MLP_d1.2.bias")), "'MLP_d1.2.bias' is missing"),
    "nan bounds": (edit_bounds([0, np.nan, 0]), "x_bound_min.pkl: the bounds are not 3 finite numbers"),
    "empty box": (edit_bounds([9, 0, 0]), "x_bound_min is not below"),
    "off the grid": (edit_column("x", 0.013), "not whole multiples .*xyz_gpcc.npz"),
    "nan positions": (edit_column("y", np.nan), "none of its 9 anchors is left: 0 have no offset, 9 cannot be drawn"),
    "no z": (edit_column("z", None), "property z is missing"),
    "missing scale": (edit_column("scale_5", None), "5 properties scale_\\*, expected 6"),
    "missing feature": (edit_column("f_anchor_feat_4", None), "4 properties f_anchor_feat_\\*, expected 5"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_wrong_model_is_refused_with_file_and_reason(name, model):
    spoil, reason = BAD[name]
    spoil(model)
    with pytest.raises(DatasetError, match=reason) as caught:
        import_hacpp(model.root)
    assert str(model.root) in str(caught.value)


def test_an_empty_scene_and_overflowing_scalings_are_refused(model):
    columns = model.columns() | {"f_mask_0": np.zeros(9), "f_mask_1": np.zeros(9)}
    with pytest.raises(DatasetError, match="9 have no offset"):
        import_hacpp(model.write(columns))
    with pytest.raises(DatasetError, match="9 cannot be drawn"):
        import_hacpp(model.write(model.columns() | {"f_mask_0": np.full(9, 2.0), "scale_0": np.full(9, 200.0)}))


@pytest.mark.parametrize("decoded", [True, False])
def test_anchors_that_cannot_be_drawn_are_left_out(decoded, model, caplog):
    columns = {name: np.array(values) for name, values in model.columns().items()}
    if not decoded:
        columns |= {name: 20 * values - 10 for name, values in columns.items() if name.startswith("f_mask_")}
    whole = import_hacpp(model.write(columns)).anchors
    columns["x"][2], columns["f_anchor_feat_1"][4], columns["scale_3"][5] = np.nan, np.inf, np.nan
    hidden = int(np.flatnonzero(~model.mask[:, 1])[0])
    columns["f_offset_1"][hidden] = np.nan
    kept = np.array([i not in (2, 4, 5) for i in range(9)])
    left = import_hacpp(model.write(columns)).anchors
    for name, values in vars(whole).items():
        assert np.array_equal(getattr(left, name), values[kept])
    assert "3 of 9 anchors cannot be drawn and are left out (the first is row 2)" in caplog.records[-1].getMessage()


def test_a_voxel_size_that_is_a_huge_array_is_refused_before_it_is_allocated(model):
    model.write()
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (1 << 45,)})
    with zipfile.ZipFile(model.root / "bitstreams" / "xyz_gpcc.npz", "w") as archive:
        archive.writestr("voxel_size.npy", head.getvalue())
    with pytest.raises(DatasetError, match=r"xyz_gpcc.npz: no voxel size .* not a single number"):
        import_hacpp(model.root)


@pytest.mark.parametrize("name", [CHECKPOINT, "bitstreams/x_bound_min.pkl"])
def test_nothing_in_a_pickle_is_executed(name, model, malicious_bytes):
    model.write()
    (model.root / name).write_bytes(malicious_bytes)
    with pytest.raises(DatasetError, match="plain tensors"):
        import_hacpp(model.root)
    assert not hasattr(builtins, "splatwire_was_here")


@pytest.mark.data
@pytest.mark.parametrize("name", ["snowmiku_15k", "snowmiku_small_2400"])
def test_official_anchors_are_exact_multiples_of_steps(name):
    folder = DATA / name
    if not (folder / "decoded.npz").exists():
        pytest.skip(f"no official model under {folder} (set SPLATWIRE_DATA)")
    scene, decoded = import_hacpp(folder), np.load(folder / "decoded.npz")
    anchors = scene.anchors
    assert scene.coding.voxel_size == float(decoded["voxel_size"])
    assert np.array_equal(voxel_indices(anchors.positions, scene.coding.voxel_size), decoded["anchor_int"])
    for ours, integers, step in (
        (anchors.features, "feat_int", "Q_feat"),
        (anchors.scalings, "scaling_int", "Q_scaling"),
        (anchors.offsets.reshape(anchors.num_anchors, -1), "offset_int", "Q_offset"),
    ):
        assert np.array_equal(ours, decoded[integers].astype(np.float32) * decoded[step][:, None])
    assert np.array_equal(anchors.mask, decoded["mask"] == 1)
    assert np.array_equal(scene.coding.context_model.grid.volume, decoded["hash_xyz"])
    assert np.array_equal(scene.coding.context_model.grid.planes[1], decoded["hash_xz"])
    assert np.array_equal(scene.coding.context_model.channel[3].hidden.weight, decoded["mlp_deform.MLP_d3.0.weight"])
    assert scene.coding.config.grid.rows(3) == tuple(np.diff(decoded["hash_xyz_offsets"]))


@pytest.mark.slow
@pytest.mark.data
def test_largest_official_model_is_read_completely():
    if not (DATA / "bonsai_30k").exists():
        pytest.skip(f"no official model under {DATA} (set SPLATWIRE_DATA)")
    scene = import_hacpp(DATA / "bonsai_30k")
    assert scene.anchors.num_anchors == 175_556
    assert int(scene.anchors.mask.sum()) == 336_784
    assert scene.coding.config.layout.feature_groups == (10,) * 5
