"""Protocols on photos with masks."""

import json

import pytest

from evaluation.masked_photos import write_photos
from evaluation.study.test_run import silent
from scenes import tiny_cameras
from splatwire.bitstream import read_stream
from splatwire.codec import decode_stream
from splatwire.evaluation.study import InProcess, Store, load_study, run_study, write_outputs
from splatwire.evaluation.study.records import TIMINGS

pytestmark = [pytest.mark.slow, pytest.mark.needs_torch]


@pytest.fixture(scope="module")
def folders(tiny_folder, tmp_path_factory):
    scene, root = decode_stream(read_stream(tiny_folder / "tiny.swz")[0]).scene, tmp_path_factory.mktemp("masked")
    return [write_photos(root / str(seed), scene, tiny_cameras(9, 72, 64), seed) for seed in (1, 2)]


def test_pixels_outside_the_masks_change_no_record(tiny_folder, folders, edited, tmp_path):
    results, stores = [], [Store(tmp_path / "first"), Store(tmp_path / "second")]
    for folder, store in zip(folders, stores, strict=True):
        study = load_study(edited((f'cameras = "{tiny_folder / "cameras.json"}"', f'photos = "{folder}"')))
        results.append(run_study(study, store, InProcess(), silent))
    free = {*TIMINGS, "unit"}
    first, second = ([{k: v for k, v in r.items() if k not in free} for r in one.merged()] for one in results)
    assert first == second
    assert len({result.scenes["made up"].references.digest for result in results}) == 2
    files = write_outputs(results[0], stores[0], tmp_path / "out")
    said = json.loads(files["json"].read_text())
    assert said["masked"] == ["made up"]
    assert said["references"] == {"made up": "photos inside their masks"}
    assert "Compared inside the masks of the photos: made up." in files["markdown"].read_text()
    assert "photos inside their masks" in files["report"].read_text()


def test_other_mask_gets_other_unit_key(tiny_folder, folders, edited, tmp_path):
    path = edited((f'cameras = "{tiny_folder / "cameras.json"}"', f'photos = "{folders[0]}"'))
    store, keys = Store(tmp_path / "store"), []
    transforms = folders[0] / "transforms.json"
    whole = transforms.read_text()
    for masked in (True, False):
        content = json.loads(whole)
        if not masked:
            del content["frames"][0]["mask_path"]
        transforms.write_text(json.dumps(content))
        result = run_study(load_study(path), store, InProcess(), silent)
        assert result.num_reused == 0
        assert result.scenes["made up"].references.masked is masked
        keys.append(set(result.records))
    transforms.write_text(whole)
    assert not keys[0] & keys[1]
