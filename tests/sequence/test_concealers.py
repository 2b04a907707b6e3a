"""Concealers of installed packages work for moving scenes like the built-in ones."""

import json

import numpy as np
import pytest

from distributions import install_page, run_with
from moving_sequences import moving_frames
from splatwire.bitstream import write_stream
from splatwire.channel import parse_loss, transmit
from splatwire.codec import decode_stream
from splatwire.concealment import concealer_names, create_concealer, register_concealer, registry
from splatwire.concealment.temporal.concealers import ConcealedMotion, temporal_concealer, temporal_concealer_names
from splatwire.errors import InvalidValueError, UnknownNameError
from splatwire.io.formats import write_splats
from splatwire.sequence import SequenceOptions, decode_frames, encode_sequence

pytestmark = pytest.mark.slow

NAMES = ("drop", "hold", "extrapolate", "neighbors", "motion")


@pytest.fixture(scope="module")
def frames():
    return moving_frames(200, 8)


@pytest.fixture(scope="module")
def lossy(frames):
    stream = encode_sequence(frames, SequenceOptions(group_frames=4))[0]
    is_keyframe = stream.manifest.plan.is_keyframe
    motion = [packet for packet in stream.packets if not is_keyframe(packet.id.block)]
    return stream.with_packets(packet for packet in stream.packets if packet not in motion[1:])


@pytest.fixture
def known(monkeypatch):
    """Restores the registry afterwards."""
    concealer_names()  # installed packages register once in a process
    for name in ("_entries", "_sources"):
        monkeypatch.setattr(registry.CONCEALERS, name, dict(getattr(registry.CONCEALERS, name)))


@pytest.fixture(scope="module")
def installed(frames, tmp_path_factory):
    """Folder with a clip, its frames, the clip with losses, and a package on the path."""
    folder = tmp_path_factory.mktemp("installed")
    install_page("your-own-concealer.md", folder / "site")
    (folder / "frames").mkdir()
    for number, splats in enumerate(frames):
        write_splats([splats], folder / "frames" / f"{number}.ply")
    stream = encode_sequence(frames, SequenceOptions(group_frames=4))[0]
    write_stream(stream, folder / "clip.swz")
    write_stream(transmit(stream, parse_loss("bernoulli:0.5"), seed=2)[0], folder / "lossy.swz")
    return folder


def test_documented_temporal_concealer_decodes_a_clip(installed):
    done = run_with(installed / "site", installed, "decode", "lossy.swz", "-o", "out", "--conceal", "drift", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["num_frames"] == 8
    assert json.loads(done.stdout)["concealer"] == "drift"


def test_documented_temporal_concealer_is_evaluated_with_all_others(installed):
    words = ["evaluate", "clip.swz", "--reference", "frames", "--loss", "bernoulli:0.5", "--views", "1", "--json"]
    done = run_with(installed / "site", installed, *words)
    assert done.returncode == 0, done.stderr
    assert [row["method"] for row in json.loads(done.stdout)["rows"]] == ["complete", *NAMES, "drift"]


def test_temporal_and_still_concealers_are_not_interchangeable(known):
    with pytest.raises(UnknownNameError, match="unknown concealer of still scenes 'hold'"):
        create_concealer("hold")
    with pytest.raises(UnknownNameError, match="unknown concealer of clips 'grow': known are drop, extrapolate, hold"):
        temporal_concealer("grow")
    assert not {"hold", "motion"} & set(concealer_names())
    assert temporal_concealer_names() == NAMES


def test_a_second_temporal_concealer_of_one_name_is_refused(known):
    with pytest.raises(InvalidValueError, match="two concealers are called 'hold'"):
        register_concealer("hold", temporal=True)(type("Other", (), {}))


@pytest.mark.parametrize(
    ("proposal", "sentence"),
    [
        (lambda lost: None, "concealer 'mine' returned NoneType, not ConcealedMotion"),
        (lambda lost: ConcealedMotion(lambda frame, arrived: np.zeros((1, 13))), r"motion of shape \(1, 13\) for \d+"),
        (
            lambda lost: ConcealedMotion(lambda frame, arrived: np.full((len(lost.tracks), 13), np.nan)),
            "concealer 'mine' returned motion that is not finite",
        ),
    ],
)
def test_invalid_proposal_is_one_error_sentence(lossy, known, proposal, sentence):
    mine = type("Mine", (), {"name": "mine", "grow": True, "__call__": lambda self, lost: proposal(lost)})
    register_concealer("mine", temporal=True)(mine)
    with pytest.raises(InvalidValueError, match=sentence):
        list(decode_frames(decode_stream(lossy).scene, "mine"))


def test_concealer_without_methods_is_one_error_sentence(known):
    register_concealer("mine", temporal=True)(type("Mine", (), {"name": "mine", "__call__": lambda self, lost: None}))
    with pytest.raises(InvalidValueError, match="concealer 'mine' is no concealer: it has no grow"):
        temporal_concealer("mine")
    register_concealer("yours")(type("Yours", (), {"name": "yours"}))
    with pytest.raises(InvalidValueError, match="concealer 'yours' is no concealer: it cannot be called"):
        create_concealer("yours")


def test_options_of_a_temporal_concealer_are_those_of_its_class():
    assert vars(temporal_concealer("motion", neighbors=3))["neighbors"] == 3
    with pytest.raises(InvalidValueError, match="concealer 'hold' does not take these options"):
        temporal_concealer("hold", speed=2)
