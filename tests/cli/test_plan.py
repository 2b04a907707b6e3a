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


def test_a_deadline_is_a_budget(run, datagrams):
    words = ("--views", 1, "--trials", 5, "--json", "--loss", "none")
    content = run("plan", datagrams, "--deadline", 0.5, "--rate", 2.0, *words).json
    assert content["budget_bytes"] == 125_000


def test_mistakes_are_told(run, journey, datagrams):
    assert "--preset datagram" in run("plan", journey / "tiny.swz").err
    assert "needs --rate" in run("plan", datagrams, "--deadline", 1.0).err
    assert "unknown loss" in run("plan", datagrams, "--loss", "weather").err.lower()
