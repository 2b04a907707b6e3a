"""Streamed SOG reads the finest present level of each leaf."""

import json
import zipfile

import numpy as np
import pytest

from splat_io.formats.handmade import some_splats
from splatwire.errors import DatasetError
from splatwire.files.kinds import SOG_LEVELS, file_kind
from splatwire.io.formats import read_content, read_splats, sog, write_splats
from splatwire.io.formats.sog import read_sog

FINE, COARSE, SKY = 60, 20, 5


def chunk(folder, count, seed):
    """A folder of SOG."""
    write_splats([some_splats(count, degree=0, seed=seed)], folder.parent / "chunk.sog")
    with zipfile.ZipFile(folder.parent / "chunk.sog") as bundle:
        bundle.extractall(folder)
    (folder.parent / "chunk.sog").unlink()


def leaf(*levels):
    """A leaf with levels (file, offset, count), the finest first."""
    named = {str(n): dict(zip(("file", "offset", "count"), level, strict=True)) for n, level in enumerate(levels)}
    return {"bound": {"min": [0, 0, 0], "max": [1, 1, 1]}, "lods": named}


NEAR = leaf((0, 0, 40), (1, 0, 12))
FAR = {"children": [leaf((2, 0, 30), (1, 12, 8)), leaf((0, 40, 20))]}
CONTENT = {
    "lodLevels": 2,
    "environment": "sky/meta.json",
    "filenames": ["0_0/meta.json", "1_0/meta.json", "0_1/meta.json"],
    "tree": {"children": [NEAR, FAR]},
}


@pytest.fixture
def folder(tmp_path):
    """Only the first of two fine chunks, all coarse chunks and the environment exist."""
    for name, count, seed in (("0_0", FINE, 1), ("1_0", COARSE, 2), ("sky", SKY, 3)):
        chunk(tmp_path / name, count, seed)
    (tmp_path / "lod-meta.json").write_text(json.dumps(CONTENT))
    return tmp_path


def test_present_chunks_are_read_and_missing_ones_reported(folder, caplog):
    parts = {name: read_sog(folder / name).splats.means for name in ("0_0", "1_0", "sky")}
    expected = np.concatenate([parts["0_0"], parts["1_0"][12:], parts["sky"]])
    for path in (folder, folder / "lod-meta.json"):
        assert file_kind(path) == SOG_LEVELS
        assert np.array_equal(read_splats(path).means, expected)
    logged = " ".join(record.getMessage() for record in caplog.records)
    assert "1 of 4 chunks are not here: 0_1" in logged
    assert "1 leaves are read at a coarser level" in logged


def changed(**fields):
    return {**CONTENT, **fields}


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ([], "is no JSON object"),
        (changed(filenames="0_0"), "no list"),
        (changed(filenames=["../0_0/meta.json"]), "names no meta.json of a folder beside it"),
        (changed(filenames=["/etc/meta.json"]), "names no meta.json of a folder beside it"),
        (changed(environment="sky/other.json"), "names no meta.json of a folder beside it"),
        (changed(tree=None), "a node that is none"),
        (changed(tree={"children": 3}), "children that are no list"),
        (changed(tree=leaf((3, 0, 1))), "no run of a chunk"),
        (changed(tree=leaf((0, -1, 1))), "no run of a chunk"),
        (changed(tree=leaf((0, 0, True))), "no run of a chunk"),
        (changed(tree={"lods": {"fine": {}}}), "is no level"),
        (changed(tree=leaf((0, 41, 20))), "which has 60, are not there or belong to two leaves"),
        (changed(tree={"children": [leaf((0, 0, 2)), leaf((0, 1, 2))]}), "are not there or belong to two leaves"),
        (changed(tree=leaf((2, 0, 4)), environment=None), "none of the 3 chunks that it names is here"),
        (changed(tree={"children": [{}] * (1 << 17)}), "more than"),
    ],
)
def test_contradictory_metadata_is_one_error(folder, content, problem):
    (folder / "lod-meta.json").write_text(json.dumps(content))
    with pytest.raises(DatasetError, match=problem):
        read_splats(folder)


def test_an_endless_tree_is_one_error(folder):
    (folder / "lod-meta.json").write_text('{"filenames": [], "tree": ' + '{"children": [' * 200_000)
    with pytest.raises(DatasetError, match="readable JSON"):
        read_splats(folder / "lod-meta.json")


def test_an_unknown_version_is_named(folder, caplog):
    (folder / "lod-meta.json").write_text(json.dumps(changed(version=1)))
    read_splats(folder)
    assert "is read as version" not in caplog.text
    (folder / "lod-meta.json").write_text(json.dumps(changed(version=9)))
    read_splats(folder)
    assert "version 9 is not known: it is read as version 1" in caplog.text


def test_a_chunk_that_is_named_often_is_opened_once(folder, monkeypatch):
    opened = []
    monkeypatch.setattr(sog, "is_antialiased", lambda chunk: opened.append(chunk) and False)
    (folder / "lod-meta.json").write_text(json.dumps(changed(filenames=CONTENT["filenames"] * 1000)))
    read_splats(folder)
    assert len(opened) == len(set(opened)) == 3


def test_gaussians_that_no_leaf_names_give_a_warning(folder, caplog):
    read_splats(folder)
    assert "no leaf of the tree names" not in caplog.text
    (folder / "lod-meta.json").write_text(json.dumps(changed(tree=leaf((0, 5, 40)))))
    assert read_splats(folder).num_gaussians == 40 + SKY
    assert f"its chunks have {FINE - 40} Gaussians that no leaf of the tree names: they are left out" in caplog.text


def test_nodes_with_other_fields_give_one_warning(folder, caplog):
    moved = {"transform": {"translation": [5, 0, 0]}}
    tree = {"children": [NEAR | moved, leaf((0, 40, 20)) | moved]}
    (folder / "lod-meta.json").write_text(json.dumps(CONTENT | {"tree": tree}))
    read_splats(folder)
    assert caplog.text.count("transform of nodes of its tree are not known") == 1


def test_a_node_with_children_and_levels_is_refused(folder):
    tree = leaf((1, 0, 12)) | {"children": [NEAR]}
    (folder / "lod-meta.json").write_text(json.dumps(CONTENT | {"tree": tree}))
    with pytest.raises(DatasetError, match="children and lods"):
        read_splats(folder)


@pytest.mark.parametrize("name", ["./0_0/meta.json", "link/meta.json"])
def test_a_chunk_with_two_names_is_one_chunk(folder, name):
    (folder / "link").symlink_to("0_0")
    names = ["0_0/meta.json", name]
    content = changed(filenames=names, environment=None, tree={"children": [leaf((0, 0, 40)), leaf((1, 40, 20))]})
    (folder / "lod-meta.json").write_text(json.dumps(content))
    assert read_splats(folder).num_gaussians == FINE
    content["tree"] = {"children": [leaf((0, 0, 40)), leaf((1, 30, 30))]}
    (folder / "lod-meta.json").write_text(json.dumps(content))
    with pytest.raises(DatasetError, match="belong to two leaves"):
        read_splats(folder)


def test_an_environment_that_is_a_chunk_of_the_tree_is_refused(folder):
    (folder / "lod-meta.json").write_text(json.dumps(changed(environment="./0_0/meta.json")))
    with pytest.raises(DatasetError, match="its environment, 0_0, is a chunk of its tree"):
        read_splats(folder)


def test_a_level_that_is_named_twice_is_refused(folder):
    levels = {"0": {"file": 0, "offset": 0, "count": 40}, "00": {"file": 1, "offset": 0, "count": 12}}
    (folder / "lod-meta.json").write_text(json.dumps(changed(tree={"lods": levels})))
    with pytest.raises(DatasetError, match="names a level twice: 0, 00"):
        read_splats(folder)


def test_chunks_that_disagree_about_antialiasing_give_a_warning(folder, caplog):
    meta = folder / "1_0" / "meta.json"
    meta.write_text(json.dumps(json.loads(meta.read_text()) | {"antialias": True}))
    assert read_content(folder).antialiased
    assert "some chunks ask for antialiasing, others do not" in caplog.text
