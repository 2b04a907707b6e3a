import pytest
import tyro

from splatwire.cli.serve import Serve


@pytest.fixture
def datagrams(run, journey, tmp_path):
    target = tmp_path / "datagrams.swz"
    outcome = run("encode", journey / "tiny.scene", "-o", target, "--preset", "datagram", "--tiers", 0.2, "--json")
    assert outcome.status == 0
    return target


def test_plan_gives_options_that_serve_understands(run, datagrams):
    words = ("--loss", "bernoulli:0.2", "--budget", 2.5, "--views", 1, "--trials", 5, "--json")
    content = run("plan", datagrams, *words).json
    assert content["head_arrives"] > 0.9
    assert len(content["lost"]) == 2
    assert content["sent_bytes"] <= content["budget_bytes"] == 2.5 * content["plain_bytes"]
    assert content["options"].startswith("--side-repair ")
    words = [str(datagrams), *content["options"].split()]
    config = (tyro.conf.FlagCreatePairsOff, tyro.conf.OmitArgPrefixes)
    settings = tyro.cli(Serve, args=words, config=config)
    assert settings.side_repair == pytest.approx(content["protection"]["side_repair"], abs=1e-3)


def test_with_a_way_back_the_plan_says_what_is_sent_again(run, datagrams):
    words = ("--loss", "bernoulli:0.2", "--views", 1, "--json", "--way-back")
    whole, part = (run("plan", datagrams, *words, "--budget", budget).json for budget in (2.0, 1.25))
    assert whole["protection"]["resend_until"] == 1.0
    assert whole["lost"] == [0.0, 0.0]
    assert whole["options"] == "--side-repair 0.000 --side-lead 0.3 --resend 4"
    assert 0 < part["protection"]["resend_until"] < 1
    assert part["lost"][0] < part["lost"][1]
    assert part["sent_bytes"] <= part["budget_bytes"]
    assert part["options"].endswith(f"--resend-until {part['protection']['resend_until']:.6g}")
    outcome = run("plan", datagrams, *words, "--most-protection", 0.001)
    assert "needs more than 0.1% of all bytes" in outcome.err


def test_a_deadline_is_a_budget(run, datagrams):
    words = ("--views", 1, "--trials", 5, "--json", "--loss", "none")
    content = run("plan", datagrams, "--deadline", 0.5, "--rate", 2.0, *words).json
    assert content["budget_bytes"] == 125_000


def test_mistakes_are_told(run, journey, datagrams):
    assert "--preset datagram" in run("plan", journey / "tiny.swz").err
    assert "needs --rate" in run("plan", datagrams, "--deadline", 1.0).err
    assert "unknown loss" in run("plan", datagrams, "--loss", "weather").err.lower()
