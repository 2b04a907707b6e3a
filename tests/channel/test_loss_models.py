import numpy as np
import pytest

from splatwire.channel import LOSS_PRESETS, Bernoulli, GilbertElliott, NoLoss, Trace, parse_loss
from splatwire.channel.trace import read_trace
from splatwire.errors import DatasetError, InvalidValueError, SplatwireError, UnknownNameError


def draw(model, n=400_000, seed=0):
    return model.received(n, np.random.default_rng(seed))


def bursts(received):
    """Lengths of the runs of lost packets."""
    edges = np.diff(np.concatenate([[0], ~received, [0]]).astype(int))
    return np.flatnonzero(edges == -1) - np.flatnonzero(edges == 1)


@pytest.mark.parametrize("rate", [0.0, 0.05, 0.2, 0.9, 1.0])
def test_bernoulli_loses_packets_at_its_rate(rate):
    received = draw(Bernoulli(rate))
    assert received.dtype == bool
    assert 1 - received.mean() == pytest.approx(rate, abs=0.003)


def test_bernoulli_losses_are_independent():
    assert bursts(draw(Bernoulli(0.2))).mean() == pytest.approx(1 / 0.8, abs=0.01)


@pytest.mark.parametrize(
    ("name", "rate", "burst", "p", "r"),
    [
        ("webrtc-20/3", 0.20, 3, 0.0833, 0.333),
        ("20/20", 0.20, 20, 0.0125, 0.05),
        ("10/8", 0.10, 8, 0.0139, 0.125),
        ("5/5", 0.05, 5, 0.0105, 0.2),
        ("2/10", 0.02, 10, 0.00204, 0.1),
        ("1/20", 0.01, 20, 0.000505, 0.05),
    ],
)
def test_presets_have_the_published_probabilities(name, rate, burst, p, r):
    model = LOSS_PRESETS[name]
    assert (model.p, model.r) == (pytest.approx(p, rel=5e-3), pytest.approx(r, rel=5e-3))
    received = draw(model, 2_000_000)
    assert 1 - received.mean() == pytest.approx(rate, rel=0.06)
    assert bursts(received).mean() == pytest.approx(burst, rel=0.06)


def test_gilbert_starts_in_its_stationary_distribution():
    """The first packet is lost as often as any other."""
    model, rng = GilbertElliott(0.2, 20), np.random.default_rng(0)
    masks = np.array([model.received(3, rng) for _ in range(20_000)])
    assert 1 - masks.mean(axis=0) == pytest.approx([0.2] * 3, abs=0.01)


def test_gilbert_elliott_with_partial_loss_keeps_its_rate():
    model = GilbertElliott(0.2, 10, arrival_bad=0.3, arrival_good=0.99)
    assert model.share_bad == pytest.approx(0.19 / 0.69)
    assert 1 - draw(model).mean() == pytest.approx(0.2, abs=0.01)


def test_gilbert_with_p_equal_to_one_minus_r_is_bernoulli():
    """With p = 1 - r the next state does not depend on the last one, so losses are independent."""
    model = GilbertElliott(0.2, 1 / 0.8)
    received = draw(model)
    after_loss = received[1:][~received[:-1]]
    assert 1 - after_loss.mean() == pytest.approx(0.2, abs=0.01)


@pytest.mark.parametrize("rate", [0, 1])
@pytest.mark.parametrize("model", [Bernoulli, lambda rate: GilbertElliott(rate, 5)])
def test_rates_zero_and_one_lose_nothing_and_everything(model, rate):
    assert (draw(model(float(rate)), 1000) == (rate == 0)).all()
    assert draw(model(float(rate)), 0).shape == (0,)


def test_equal_seeds_give_equal_masks():
    for model in (Bernoulli(0.2), GilbertElliott(0.2, 3)):
        assert (draw(model, 100, 7) == draw(model, 100, 7)).all()
        assert (draw(model, 100, 7) != draw(model, 100, 8)).any()


@pytest.mark.parametrize(
    "spec",
    ["none", "bernoulli:0.2", "bernoulli:0", "bernoulli:1", "gilbert:0.2,20", "gilbert:0.123456789,3.5,0.25,0.99"],
)
def test_names_of_loss_models_are_parsed_back(spec):
    model = parse_loss(spec)
    assert model.name == spec
    assert parse_loss(model.name) == model
    assert model.unit == "pak"


def test_loss_specifications_are_parsed():
    assert parse_loss("none") == NoLoss()
    assert parse_loss("bernoulli:0.2") == Bernoulli(0.2)
    assert parse_loss("gilbert:webrtc-20/3") == GilbertElliott(0.2, 3)
    assert parse_loss(" gilbert:0.1,8 ") == GilbertElliott(0.1, 8)


@pytest.mark.parametrize(
    ("spec", "error", "message"),
    [
        ("", UnknownNameError, "loss model"),
        ("burst:3", UnknownNameError, "unknown loss model 'burst:3': known are bernoulli:RATE"),
        ("none:1", UnknownNameError, "none:1"),
        ("bernoulli", InvalidValueError, "should look like bernoulli:RATE"),
        ("bernoulli:x", InvalidValueError, "should look like bernoulli:RATE"),
        ("bernoulli:0.1,2", InvalidValueError, "should look like bernoulli:RATE"),
        ("bernoulli:20", InvalidValueError, "from 0 to 1, not 20"),
        ("bernoulli:nan", InvalidValueError, "not nan"),
        ("gilbert:", InvalidValueError, "gilbert:RATE,BURST"),
        ("gilbert:30/3", UnknownNameError, "gilbert preset '30/3'"),
        ("gilbert:0.2,0.5", InvalidValueError, "at least 1 packet"),
        ("gilbert:0.2,inf", InvalidValueError, "at least 1 packet"),
        ("gilbert:-0.1,5", InvalidValueError, "loss rate"),
        ("gilbert:0.9,2", InvalidValueError, "needs a mean burst of at least 9, not 2"),
        ("gilbert:0.5,2,0.9,0.95", InvalidValueError, "states that lose"),
        ("gilbert:0.2,3,0.5", InvalidValueError, "gilbert:RATE,BURST"),
        ("trace:", InvalidValueError, "trace:FILE"),
        ("trace:/nowhere/at/all", DatasetError, "/nowhere/at/all is not a file"),
    ],
)
def test_errors_name_the_invalid_part(spec, error, message):
    with pytest.raises(error, match=message) as caught:
        parse_loss(spec)
    assert isinstance(caught.value, SplatwireError)


@pytest.mark.parametrize(
    "text",
    [
        "110100",
        "1\n1\n0\n1\n0\n0\n",
        "1,1,0,1,0,0",
        "# a call\nreceived RECEIVED lost # gap\nreceived\nLost,lost",
        "11 01\r\n00",
    ],
)
def test_trace_files_of_every_layout_are_read(tmp_path, text):
    (tmp_path / "loss.txt").write_text(text)
    assert draw(Trace(tmp_path / "loss.txt"), 6).tolist() == [True, True, False, True, False, False]


def test_trace_in_the_documentation_is_valid(pytestconfig, tmp_path):
    text = (pytestconfig.rootpath / "docs" / "transport.md").read_text(encoding="utf-8")
    path = tmp_path / "trace.txt"
    path.write_text(text.partition("A trace is text")[2].partition("```text\n")[2].partition("```")[0])
    assert "".join(str(int(arrived)) for arrived in read_trace(path)) == "1111011001101"


def test_trace_that_is_too_short_is_refused(tmp_path):
    path = tmp_path / "loss.txt"
    path.write_text("10")
    assert draw(parse_loss(f"trace:{path},repeat"), 5).tolist() == [True, False, True, False, True]
    assert parse_loss(f"trace:{path},repeat").name == f"trace:{path},repeat"
    with pytest.raises(DatasetError, match="has 2 entries and 5 packets are sent"):
        draw(parse_loss(f"trace:{path}"), 5)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "no entries"),
        (b"# nothing", "no entries"),
        (b"11\n102\n", "line 2"),
        (b"yes", "line 1"),
        (b"\xff\x00", "line 1"),
    ],
)
def test_invalid_traces_are_refused(tmp_path, data, message):
    (tmp_path / "loss.txt").write_bytes(data)
    with pytest.raises(DatasetError, match=rf"loss\.txt.*{message}"):
        Trace(str(tmp_path / "loss.txt"))
    with pytest.raises(DatasetError, match="is not a file"):
        Trace(tmp_path)


@pytest.mark.parametrize("model", [GilbertElliott(0.2, 20), GilbertElliott(0.6, 2), GilbertElliott(0.5, 1),
                                   GilbertElliott(0.2, 3, 0.1, 0.95), GilbertElliott(0.95, 25)])  # fmt: skip
def test_states_equal_a_step_by_step_simulation(model):
    for n in (0, 1, 2, 500):
        rng = np.random.default_rng(n)
        draws = rng.random(n)
        bad, arrives = bool(rng.random() < model.share_bad), []
        for luck, draw in zip(rng.random(n), draws, strict=True):
            arrives.append(bool(luck < (model.arrival_bad if bad else model.arrival_good)))
            bad = not draw < model.r if bad else bool(draw < model.p)
        assert model.received(n, np.random.default_rng(n)).tolist() == arrives
