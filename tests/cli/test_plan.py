import json

import pytest

from splatwire.bitstream import read_stream
from splatwire.cli import _run_serve
from splatwire.cli.serve import Serve
from splatwire.errors import InvalidValueError, UnsupportedVersionError
from splatwire.planning.plan_file import FORMER_KEYS, MAX_BYTES, plan_content, read_plan
from splatwire.transport import Protection, make_served_stream

pytestmark = pytest.mark.slow


@pytest.fixture
def datagrams(run, journey, tmp_path):
    target = tmp_path / "datagrams.swz"
    outcome = run("encode", journey / "tiny.scene", "-o", target, "--preset", "datagram", "--tiers", 0.2, "--json")
    assert outcome.status == 0
    return target


def test_serve_accepts_a_plan_file(run, datagrams, tmp_path):
    target = tmp_path / "plan.json"
    words = ("--loss", "bernoulli:0.2", "--budget", 2.5, "--views", 1, "--trials", 5, "-o", target)
    content = run("plan", datagrams, *words, "--json").json
    assert content["head_arrives"] > 0.9
    assert len(content["lost"]) == 2
    assert content["sent_bytes"] <= content["budget_bytes"] == 2.5 * content["plain_bytes"]
    assert json.loads(target.read_text()) == content
    serve = Serve((str(datagrams),), plan=target)
    protection, planned = _run_serve.protection(serve)
    stream = read_stream(datagrams)[0]
    assert planned == stream.manifest.stream_id
    assert content["protection"] == json.loads(json.dumps(vars(protection)))
    (program,) = _run_serve._served_streams(serve, protection, planned).served.values()
    assert program.schedule == make_served_stream(stream, protection).schedule
    printed = run("plan", datagrams, *words).out
    assert f"splatwire serve {datagrams} --plan {target}" in printed
    assert f"expected {content['psnr']:.2f} dB, if the complete scene has 30 dB\n" in printed


def test_plan_of_another_stream_or_with_conflicting_options_is_refused(run, journey, datagrams, tmp_path):
    target = tmp_path / "plan.json"
    target.write_text(json.dumps(plan_content(Protection(), 7, {})))
    assert "is for the stream 00000007" in run("serve", datagrams, "--plan", target).err
    for words in (("--init-repair", 0.1), ("--protect", "tier0=0.1")):
        assert "--plan sets the protection" in run("serve", datagrams, "--plan", target, *words).err
    assert "No such file" in run("serve", datagrams, "--plan", tmp_path / "none.json").err


@pytest.mark.parametrize(
    "protection",
    [Protection(), Protection(0.1, 0.5, 80, 0.02, (0.5, 0.1), 0.8, 0.3, 0.25, 0.5), Protection(init_symbol_bytes=64)],
)
def test_plan_round_trips_through_json(protection):
    content = plan_content(protection, 0xFEED, {"psnr": 30.0})
    assert read_plan(json.dumps(content).encode(), "plan.json") == (protection, 0xFEED)


def test_invalid_plan_file_is_one_error_line():
    good = plan_content(Protection(), 7, {})

    def refused(change, message, kind=InvalidValueError):
        data = change if isinstance(change, bytes) else json.dumps({**good, **change}).encode()
        with pytest.raises(kind, match=message) as error:
            read_plan(data, "plan.json")
        assert len(str(error.value)) < 300
        assert "plan.json" in str(error.value)

    def protected(**values):
        return {"protection": {**good["protection"], **values}}

    for data in (b"", b"7", b"[]", b"{}", b"\xff", b"[" * 60_000, b" " * (MAX_BYTES + 1), b'{"format": 1}'):
        refused(data, "is no plan")
    refused(json.dumps(good).encode()[:-9], "is no plan")
    refused({"version": 2}, "version 2", UnsupportedVersionError)
    refused({"version": [[]] * 99}, "of version", UnsupportedVersionError)
    for wrong in (None, 7, "7", "0000000g", "000000007"):
        refused({"stream_id": wrong}, "8 hexadecimal digits")
    refused({"protection": 3}, "must have")
    refused(protected(more=1), "must have")
    refused({"protection": {"init_repair": 0.1}}, "must have")
    for wrong in (None, "1", True, [1], float("nan"), float("inf")):
        refused(protected(init_repair=wrong), "init_repair is no number")
    refused(json.dumps({**good, **protected(init_repair="X")}).encode().replace(b'"X"', b"9" * 5000), "no number")
    refused(protected(init_repair=-1), "from 0 to")
    refused(protected(tier_repair=[0.1] * 9), "at most 8")
    refused(protected(tier_repair=[None]), "tier_repair is no number")
    refused(protected(tier_repair=[3.0]), "from 0 to")
    refused(protected(init_symbol_bytes=80.5), "no whole number")
    refused(protected(init_symbol_bytes=81), "multiple of")
    refused(protected(retransmit_share=5), "from 0 to")


def test_plan_files_with_former_keys_are_read():
    protection = Protection(0.5, 0.25, 128, 0.1, (0.2,), retransmit_share=1.0, retransmit_until=0.5)
    content = plan_content(protection, 7, {})
    former = {current: name for name, current in FORMER_KEYS.items()}
    renamed = {former.get(key, key): value for key, value in content["protection"].items()}
    assert len(renamed.keys() - content["protection"].keys()) == len(FORMER_KEYS)
    assert read_plan(json.dumps({**content, "protection": renamed}).encode(), "plan.json") == (protection, 7)
    both = {**content["protection"], "side_repair": 0.1}
    with pytest.raises(InvalidValueError, match="must have"):
        read_plan(json.dumps({**content, "protection": both}).encode(), "plan.json")


def test_plan_with_feedback_states_what_is_retransmitted(run, datagrams):
    words = ("--loss", "bernoulli:0.2", "--views", 1, "--json", "--feedback")
    whole, part = (run("plan", datagrams, *words, "--budget", budget).json for budget in (2.0, 1.25))
    assert whole["protection"] == {**vars(Protection(0.0, retransmit_share=4.0)), "tier_repair": [], "motion": []}
    assert whole["lost"] == [0.0, 0.0]
    assert 0 < part["protection"]["retransmit_until"] < 1
    assert part["lost"][0] < part["lost"][1]
    assert part["sent_bytes"] <= part["budget_bytes"]
    outcome = run("plan", datagrams, *words, "--most-protection", 0.001)
    assert "needs more than 0.1% of all bytes" in outcome.err


def test_option_way_back_is_a_deprecated_alias_of_feedback(run, datagrams):
    words = ("--loss", "bernoulli:0.2", "--views", 1, "--json", "--budget", 2.0)
    former, now = (run("plan", datagrams, *words, option) for option in ("--way-back", "--feedback"))
    assert former.json == now.json
    assert "--way-back is now --feedback" in former.err
    assert "--way-back" not in now.err


def test_deadline_is_converted_to_a_byte_budget(run, datagrams):
    words = ("--views", 1, "--trials", 5, "--json", "--loss", "none")
    content = run("plan", datagrams, "--deadline", 0.5, "--rate", 2.0, *words).json
    assert content["budget_bytes"] == 125_000


def test_stream_is_planned_in_the_packets_it_is_served_in(run, journey, tmp_path):
    from splatwire.bitstream import PRESETS, read_stream
    from splatwire.codec import repack

    outcome = run("plan", journey / "tiny.swz", "--views", 1, "--trials", 5, "-o", tmp_path / "plan.json")
    assert "packets that fit datagrams" in outcome.err
    served = repack(read_stream(journey / "tiny.swz")[0], PRESETS["datagram"])
    assert json.loads((tmp_path / "plan.json").read_text())["stream_id"] == f"{served.manifest.stream_id:08x}"


def test_a_plan_does_not_replace_its_stream(run, datagrams):
    before = datagrams.read_bytes()
    outcome = run("plan", datagrams, "--views", 1, "--trials", 5, "-o", datagrams)
    assert outcome.status == 2
    assert "is the input" in outcome.err
    assert datagrams.read_bytes() == before


def test_invalid_options_are_one_error_line(run, datagrams):
    assert "--deadline and --rate together" in run("plan", datagrams, "--deadline", 1.0).err
    assert "unknown loss" in run("plan", datagrams, "--loss", "weather").err.lower()
    assert "a plan is a file" in run("plan", datagrams, "-o", "-").err


def test_motion_protection_of_a_plan_is_validated():
    content = plan_content(Protection(motion=((0.5, 0.25), (1.0, 0.1))), 7, {})
    text = json.dumps(content)
    assert read_plan(text.encode(), "plan.json")[0].motion == ((0.5, 0.25), (1.0, 0.1))
    older = json.loads(text)
    del older["protection"]["motion"]
    assert read_plan(json.dumps(older).encode(), "plan.json")[0].motion == ()
    for wrong in ([[1.0]], 3, [[2.0, 0.1]], [[0.5, "x"]], [[0.5, 0.1]] * 5000):
        other = {**content, "protection": {**content["protection"], "motion": wrong}}
        with pytest.raises(InvalidValueError, match="motion"):
            read_plan(json.dumps(other).encode(), "plan.json")
