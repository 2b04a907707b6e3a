"""Public names exist, are typed and load no heavy module."""

import dataclasses
import importlib
import re
import runpy
import subprocess
import sys
from operator import attrgetter
from pathlib import Path

import numpy as np
import pytest

import splatwire
from splatwire.codec import ProgressiveDecoder
from splatwire.codec.schema import CodedPackets
from splatwire.reprs import summary_repr
from splatwire.sequence import SequenceEncoder, SequenceOptions, TrackingReport
from splatwire.transport import Receiver, Welcomed, make_served_stream
from splatwire.types import LossMask
from transport.network import datagram_stream

PUBLIC: list[str] = vars(splatwire)["__all__"]


@pytest.mark.needs_torch
def test_public_names_exist_and_have_their_own_name():
    for name in PUBLIC:
        value = getattr(splatwire, name)
        assert name == "__version__" or value.__name__ == name


def test_dir_lists_the_public_names():
    assert set(PUBLIC) <= set(dir(splatwire))


def test_unknown_names_are_attribute_errors():
    with pytest.raises(AttributeError, match="teleport"):
        attrgetter("teleport")(splatwire)


@pytest.mark.parametrize(
    ("package", "old", "new"),
    [
        ("splatwire", "Partial", "ReceivedScene"),
        ("splatwire.sequence", "encode_clip", "encode_sequence"),
        ("splatwire.codec", "add_concealment", "with_section"),
        ("splatwire.codec", "without_concealment", "without_section"),
        ("splatwire.types", "ExpectedPlaces", "PredictedPositions"),
        ("splatwire.bitstream", "ANCHORS", "HACPP_ANCHORS"),
    ],
)
def test_deprecated_names_warn_and_give_the_new_object(package, old, new):
    module = importlib.import_module(package)
    with pytest.warns(DeprecationWarning, match=f"{package}.{new}"):
        value = getattr(module, old)
    assert value is getattr(module, new)
    assert old not in module.__all__


def test_deprecated_methods_of_a_stream_warn_and_call_the_new_ones():
    stream, _ = splatwire.read_stream(Path(splatwire.__file__).parent / "assets" / "snowmiku_gaussians.swz")
    with pytest.warns(DeprecationWarning, match="use require_static"):
        assert stream.still() is stream
    with pytest.warns(DeprecationWarning, match="use part_sizes"):
        assert stream.parts() == stream.part_sizes()


@pytest.mark.parametrize(("old", "new"), [("partial", "received_scene"), ("num_known", "num_received")])
def test_deprecated_properties_of_a_decoder_warn_and_give_the_new_value(old, new):
    stream, _ = splatwire.read_stream(Path(splatwire.__file__).parent / "assets" / "snowmiku_gaussians.swz")
    decoder = ProgressiveDecoder(stream.manifest, stream.side_info)
    with pytest.warns(DeprecationWarning, match=f"use {new}"):
        assert getattr(decoder, old) is getattr(decoder, new)


def test_deprecated_masks_warn_and_give_the_new_value():
    stream, _ = splatwire.read_stream(Path(splatwire.__file__).parent / "assets" / "snowmiku_gaussians.swz")
    received = splatwire.decode(stream.with_packets(stream.packets[::2]))
    for owner in (received, received.loss_mask):
        with pytest.warns(DeprecationWarning, match="use fully_received"):
            assert np.array_equal(owner.known, owner.fully_received)
    with pytest.warns(DeprecationWarning, match="use prediction"):
        assert received.expectation is received.prediction


def test_deprecated_mask_of_anchors_and_range_of_gaussians_warn_and_give_the_new_result():
    stream, _ = splatwire.read_stream(Path(splatwire.__file__).parent / "assets" / "snowmiku_gaussians.swz")
    with pytest.warns(DeprecationWarning, match="use of_elements"):
        assert LossMask.of_anchors(np.arange(3) > 0).num_lost == 1
    scene = splatwire.decode(stream).scene
    assert isinstance(scene, splatwire.SplatScene)
    with pytest.warns(DeprecationWarning, match="use slice_range"):
        assert np.array_equal(scene.splats.run(2, 5).means, scene.splats.means[2:5])


def test_deprecated_header_of_a_sequence_encoder_warns_and_gives_the_new_result():
    stream, _ = splatwire.read_stream(Path(splatwire.__file__).parent / "assets" / "snowmiku_gaussians.swz")
    scene = splatwire.decode(stream).scene
    assert isinstance(scene, splatwire.SplatScene)
    encoder = SequenceEncoder(SequenceOptions(group_frames=1))
    encoder.push(scene.splats.slice_range(0, 50))
    with pytest.warns(DeprecationWarning, match="use current_header"):
        assert encoder.so_far(1) == encoder.current_header(1)


@pytest.mark.parametrize(("old", "new"), [
    ("tracked", "num_same_order_frames"), ("matched", "num_matched_frames"), ("share", "matched_share"),
    ("born", "num_births"),
])  # fmt: skip
def test_deprecated_statistics_of_tracking_warn_and_give_the_new_value(old, new):
    report = TrackingReport(1, 2, 0.5, 3)
    with pytest.warns(DeprecationWarning, match=f"use {new}"):
        assert getattr(report, old) == getattr(report, new)


def test_deprecated_size_of_an_init_segment_warns_and_gives_the_new_value():
    welcomed = Welcomed(num_packets=3, init_segment_bytes=500)
    with pytest.warns(DeprecationWarning, match="use init_segment_bytes"):
        assert welcomed.head_bytes == 500


def test_deprecated_attributes_of_transfers_warn_and_give_the_new_value():
    with pytest.warns(DeprecationWarning, match="use was_live"):
        assert Receiver(1, 0.0).is_live is False
    pytest.importorskip("raptorq", reason="the package raptorq is not installed")
    stream = make_served_stream(datagram_stream(num_anchors=50))
    with pytest.warns(DeprecationWarning, match="use max_packet_bytes"):
        assert stream.packet_bytes == stream.max_packet_bytes > 0


def test_public_names_do_not_shadow_packages():
    """`splatwire.render` stays the package after any import order."""
    packages = {path.name for path in Path(splatwire.__file__).parent.iterdir() if (path / "__init__.py").exists()}
    assert not packages & set(PUBLIC)


@pytest.mark.parametrize("package", ["io", "types", "io.formats", "bitstream", "channel", "codec", "concealment",
                                  "render", "data", "metrics", "evaluation", "sequence", "lod"])  # fmt: skip
def test_packages_export_every_name_in_all(package):
    module = importlib.import_module(f"splatwire.{package}")
    assert module.__all__
    assert len(set(module.__all__)) == len(module.__all__)
    assert [name for name in module.__all__ if not hasattr(module, name)] == []


ARRAY = re.compile(r"ndarray|Float|Int\d|Bool\[|\bbytes\b")
"""Annotations of fields with arrays, or bytes of any length."""


@pytest.mark.needs_torch
@pytest.mark.parametrize("package", ["", ".io", ".types", ".io.formats", ".bitstream", ".channel", ".codec",
                                  ".concealment", ".render", ".data", ".evaluation", ".sequence", ".lod",
                                  ".transport", ".neural.training"])  # fmt: skip
def test_public_records_show_shapes_instead_of_arrays(package):
    module = importlib.import_module(f"splatwire{package}")
    shown_as_numbers = [
        name
        for name in vars(module)["__all__"]
        if name != "FileFormat"  # one of its functions takes bytes
        and dataclasses.is_dataclass(kind := getattr(module, name))
        and any(field.repr and ARRAY.search(str(field.type)) for field in dataclasses.fields(kind))
        and kind.__repr__ is not summary_repr
    ]
    assert shown_as_numbers == []


NOT_IN_THE_REFERENCE = {
    "cli": "its verbs have a page of their own",
    "entropy": "integers and bytes, which only the codec calls",
    "files": "what readers of files share",
    "ops": "kernels that other packages call",
}


@pytest.mark.needs_torch
@pytest.mark.slow
def test_every_package_is_in_the_reference():
    pytest.importorskip("mkdocs")
    pages = runpy.run_path(str(Path(__file__).resolve().parents[2] / "docs" / "reference.py"))
    packages = {path.name for path in Path(splatwire.__file__).parent.iterdir() if (path / "__init__.py").exists()}
    shown = {package.partition(".")[0] for package in pages["PACKAGES"]}
    assert packages - shown == set(NOT_IN_THE_REFERENCE)
    names = {
        package: pages["public_names"](importlib.import_module(f"splatwire.{package}")) for package in pages["PACKAGES"]
    }
    assert all(names.values())
    text = "".join(pages["_python"]())
    for name in ("import_hacpp", "import_scaffold", "fit_splats", "read_splats", "preview_for_scene", "plan_protection",
                 "load_study"):  # fmt: skip
        assert f".{name}\n" in text


def test_import_loads_no_heavy_module():
    code = (
        "import sys, splatwire\nheavy = {'torch', 'numpy', 'numba'} & set(sys.modules)\n"
        "sys.exit(f'loaded {heavy}' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.needs_torch
@pytest.mark.slow
def test_every_module_is_importable():
    """A module that depends on an earlier import would fail for users who import it first."""
    root = Path(splatwire.__file__).parent
    for path in sorted(root.rglob("*.py")):
        words = path.relative_to(root.parent).with_suffix("").parts
        if words[-1] == "__main__":
            continue
        name = ".".join(words[:-1] if words[-1] == "__init__" else words)
        importlib.import_module(name)


def test_decoded_rows_of_coded_packets_have_their_former_name_with_a_warning():
    coded, former = CodedPackets(np.array([2]), [b"ab"], (np.arange(2),)), "rows"
    with pytest.warns(DeprecationWarning, match="use decoded_rows"):
        assert getattr(coded, former) is coded.decoded_rows
