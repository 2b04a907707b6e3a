"""Only the modules of a list test the scene kind: schemas, api, limits, training, file readers and writers.

A test of the kind is an `isinstance`, a pattern or `check_kind` with a scene type, a schema's name, or a comparison of
element names. A new scene type needs a case in each of them.
"""

import ast
from collections.abc import Iterator
from pathlib import Path

import splatwire

SOURCE = Path(splatwire.__file__).parent
MAY_ASK = ("codec/anchors/", "codec/gaussians/", "codec/sequence/", "codec/lod/", "codec/update/",
           "anchors/", "neural/", "io/formats/", "types/splat_scene.py", "types/anchor_scene.py",
           "types/splats.py", "types/anchors.py", "bitstream/limits.py", "evaluation/study/inputs.py",
           "lod/tileset.py", "api/coding.py")  # fmt: skip
KINDS = {"AnchorScene", "SplatScene", "SequenceScene", "HacppCoding", "CausalCoding", "Anchors", "Splats"}
SCHEMAS = {"HACPP_ANCHORS", "CAUSAL", "GAUSSIANS", "TRACKS"}
WORDS = {"anchors", "Gaussians", "hacpp", "causal", "gaussians", "tracks"}


def test_scene_kinds_are_tested_only_in_listed_modules():
    assert {name: count for name, count in _counts() if count} == {}


def test_kind_tests_are_detected():
    asked = (
        "isinstance(scene, AnchorScene)",
        "check_kind(scene, SplatScene, '')",
        "codec == GAUSSIANS",
        "x == 'anchors'",
        "scene.ELEMENTS != word",
    )
    for text in asked:
        assert any(map(_is_question, ast.walk(ast.parse(text)))), text


def _counts() -> Iterator[tuple[str, int]]:
    for path in sorted(SOURCE.rglob("*.py")):
        name = path.relative_to(SOURCE).as_posix()
        if not name.startswith(MAY_ASK):
            yield name, sum(map(_is_question, ast.walk(ast.parse(path.read_text(encoding="utf-8")))))


def _is_question(node: ast.AST) -> bool:
    match node:
        case ast.Call(func=ast.Name(id="isinstance" | "check_kind"), args=[_, kind, *_]):
            return bool(_names(kind) & KINDS)
        case ast.MatchClass(cls=kind):
            return bool(_names(kind) & KINDS)
        case ast.Name(id=name, ctx=ast.Load()):
            return name in SCHEMAS
        case ast.Compare():
            return any(map(_is_word, ast.walk(node)))
    return False


def _is_word(node: ast.AST) -> bool:
    match node:
        case ast.Constant(value=str(word)):
            return word in WORDS
        case ast.Attribute(attr=name):
            return name == "ELEMENTS"
    return False


def _names(node: ast.AST) -> set[str]:
    return {n.id for n in ast.walk(node) if isinstance(n, ast.Name)}
