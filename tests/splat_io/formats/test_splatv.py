"""Handmade `.splatv` files: positions over time, and errors for damaged files."""

import numpy as np
import pytest

from moving_sequences import GAUSSIANS, splatv
from splatwire.errors import DatasetError, InvalidValueError
from splatwire.files.kinds import file_kind
from splatwire.io.formats import read_splatv
from splatwire.sequence import SequenceOptions, encode_sequence, is_sequence, open_sequence


@pytest.mark.parametrize("before", [b"", b"something else"])
def test_positions_follow_their_polynomials(tmp_path, before):
    path = tmp_path / "a.splatv"
    path.write_bytes(splatv(before=before))
    assert file_kind(path).key == "splatv"
    moving = read_splatv(path)
    for time in (0.0, 0.25, 1.0):
        splats, since = moving.at(time), time - 0.25
        assert splats.num_gaussians == 2  # padding has no Gaussian
        assert splats.means[0].tolist() == pytest.approx([1 + since, 2 + 2 * since**2, 3 + 4 * since**3])
        turned = np.array([1, since, 0, 0]) / np.hypot(1, since)
        assert splats.quats[0].tolist() == pytest.approx(turned.tolist())
        assert splats.scales[0].tolist() == [0.5, 0.25, 0.125]
        assert splats.opacities[0].item() == pytest.approx(np.exp(-((since / 4) ** 2)))
        gone = np.exp(-(((time - 0.5) / 0.125) ** 2))
        assert splats.opacities[1].item() == pytest.approx(0.4 * gone if gone >= 0.02 else 0)
    assert (0.5 + 0.28209479 * splats.sh[0, 0]).tolist() == pytest.approx([1, 0, 0.2], abs=1e-6)
    with pytest.raises(InvalidValueError, match="from 0 to 1"):
        moving.at(1.5)


def test_splatv_clip_has_births_and_deaths(tmp_path):
    path = tmp_path / "a.splatv"
    many = [((n / 9, 0, 0), *GAUSSIANS[n % 2][1:]) for n in range(40)]
    path.write_bytes(splatv(many))
    assert is_sequence(path)
    sequence = open_sequence(path, 9)
    assert [int(frame.drawn.sum()) for frame in sequence.read()] == [20, 20, 20, 40, 40, 40, 20, 20, 20]
    assert open_sequence(path).num_frames == 50
    _, tracking = encode_sequence(sequence.read(), SequenceOptions(order=sequence.order))
    assert (tracking.num_matched_frames, tracking.matched_share) == (0, 1.0)
    with pytest.raises(InvalidValueError, match="frames, not 0"):
        open_sequence(path, 0)


def test_undrawable_gaussians_are_reported_once(tmp_path, caplog):
    """The message is not repeated for each frame."""
    path, broken = tmp_path / "a.splatv", ((float("nan"), 0, 0), *GAUSSIANS[0][1:])
    path.write_bytes(splatv([*GAUSSIANS, broken]))
    frames = list(open_sequence(path, 5).read())
    assert [int(frame.drawn.sum()) for frame in frames] == [1, 1, 2, 1, 1]
    assert [record.message for record in caplog.records if record.levelname == "WARNING"] == [
        f"{path} at time 0: 1 of 3 Gaussians cannot be drawn and are left out (the first is row 2)"
    ]


def test_damage_is_one_error_line(tmp_path):
    path, good = tmp_path / "a.splatv", splatv()
    begin = good.index(b"}]") + 2
    for data, message in (
        (good[:6], "not a .splatv file"),
        (good[:4] + b"\xff" * 4 + good[8:], "a list of 4294967295 bytes"),
        (good[:-1], "cut"),
        (good.replace(b'"splat"', b'"splot"'), "names no piece"),
        (good.replace(b'"size": 256', b'"size": -56'), "names no piece"),
        (good.replace(b'"size": 256', b'"size": 255'), "not 64 bytes"),
        (good.replace(b'"size": 256', b'"size": 000'), "names no piece"),
        (good[:8] + b"{" * (begin - 8) + good[begin:], "names no piece"),
        (good[:begin] + bytes(len(good) - begin), "no Gaussian"),
    ):
        path.write_bytes(data)
        with pytest.raises(DatasetError, match=message):
            read_splatv(path)


def test_signalling_nan_is_an_invalid_gaussian(tmp_path):
    path, good = tmp_path / "a.splatv", splatv()
    records = np.frombuffer(good[good.index(b"}]") + 2 :][:256], np.uint16).reshape(-1, 32).copy()
    records[0, 30] = 0x7C01
    path.write_bytes(good[: good.index(b"}]") + 2] + records.tobytes())
    assert np.isnan(read_splatv(path).at(0.5).means[0]).all()
