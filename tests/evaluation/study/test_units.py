"""The name of a unit depends on all declared inputs and on nothing else."""

import dataclasses

import pytest

from splatwire.bitstream import Packetization
from splatwire.evaluation.study import InProcess, Row, Store, load_study, run_study, units
from splatwire.evaluation.study.records import PROTOCOL_VERSION

PINNED = {3: {"contiguous": (18.6899, 0.73491), "drop": (18.7785, 0.67235), "idw": (19.6027, 0.64919)}}
"""PSNR and SSIM of the first view under seed 0, by version.

If figures change, raise PROTOCOL_VERSION and pin them again, because the records in the stores of users are outdated.
"""


def silent(task, share):
    pass


@pytest.fixture(scope="module")
def done(tiny_folder, tmp_path_factory):
    return run_study(
        load_study(tiny_folder / "protocol.toml"), Store(tmp_path_factory.mktemp("s")), InProcess(), silent
    )


@pytest.mark.needs_torch
def test_records_of_this_protocol_version_are_pinned(done):
    first = {cell.row.key: done.records[cell.unit.key][0] for cell in done.cells if cell.seed == 0}
    assert set(PINNED) == {PROTOCOL_VERSION}
    for key, (psnr, ssim) in PINNED[PROTOCOL_VERSION].items():
        assert (first[key].psnr, first[key].ssim) == (pytest.approx(psnr, abs=2e-3), pytest.approx(ssim, abs=2e-4))


@pytest.mark.needs_torch
def test_unit_key_depends_on_every_input_and_on_no_path(done):
    unit = done.cells[-1].unit
    changes = {
        "scene": "other", "seed": 9, "conceal": "prior", "options": {"neighbors": 3}, "file_digest": "x",
        "erode": "scaling", "metrics": ("psnr",), "lpips_digest": "x", "lpips_views": 1, "renderer": "reference",
        "mask": done.cells[1].unit.mask, "loss": dataclasses.replace(unit.loss, unit="datagram"),
        "stream": dataclasses.replace(unit.stream, digest="x"),
        "references": dataclasses.replace(unit.references, digest="x"),
    }  # fmt: skip
    keys = [dataclasses.replace(unit, **{name: value}).key for name, value in changes.items()]
    assert len({unit.key, *keys}) == len(keys) + 1
    places = {
        "label": "other", "weights": "/elsewhere", "pictures": (1,), "hardest": 2,
        "stream": dataclasses.replace(unit.stream, path="/elsewhere"),
        "references": dataclasses.replace(unit.references, renders="elsewhere"),
    }  # fmt: skip
    assert {dataclasses.replace(unit, **{name: value}).key for name, value in places.items()} == {unit.key}
    assert set(changes) | set(places) == {field.name for field in dataclasses.fields(unit)}


@pytest.mark.needs_torch
def test_other_code_version_reuses_no_record_and_no_loss_map(done, monkeypatch):
    unit, pinned_map = done.cells[0].unit, done.cells[1].unit.loss_map(0)
    monkeypatch.setattr(units, "CODE", "0.0.0/0")
    assert dataclasses.replace(unit).key != unit.key
    assert done.cells[1].unit.loss_map(0) != pinned_map


@pytest.mark.needs_torch
@pytest.mark.parametrize("how", ["shipped", "option"])
def test_other_scene_free_network_gets_other_unit_key(tiny_folder, tmp_path, monkeypatch, how):
    """The name changes even if the file keeps its name."""
    from splatwire.concealment import registry
    from splatwire.concealment.scene_free import default_anchor_weights, save_network

    file = tmp_path / "network.safetensors"
    save_network(default_anchor_weights(), file)
    settings = {
        "shipped": {"conceal": "scene_free"},
        "option": {"conceal": "scene_free", "options": {"weights": str(file)}},
    }[how]
    known = dataclasses.replace(registry.CONCEALERS["scene_free"].static, shipped=(file,))  # type: ignore[type-var]
    monkeypatch.setitem(registry.CONCEALERS._entries, "scene_free", registry.NamedConcealers(static=known))
    row = Row("network", "network", Packetization(block_size=60), **settings)
    study = dataclasses.replace(
        load_study(tiny_folder / "protocol.toml"), rows=(row,), baseline=None, published=(), seeds=(0,), views=1
    )
    keys = []
    for number in "12":
        save_network(default_anchor_weights(), file, record={"trained": number})
        (cell,) = run_study(study, Store(tmp_path / "store"), InProcess(), silent).cells
        keys.append(cell.unit.key)
    assert keys[0] != keys[1]
