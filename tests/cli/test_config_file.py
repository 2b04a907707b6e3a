"""A configuration file is equal to options of the command line, which win over it."""

from pathlib import Path

import pytest

from splatwire.cli._listening import check_listening
from splatwire.cli._parsing import parse_verb

DEPLOY = Path(__file__).parents[2] / "deploy"


@pytest.fixture
def file(tmp_path):
    def write(text):
        (tmp_path / "serve.toml").write_text(text)
        return tmp_path / "serve.toml"

    return write


def parsed(*words):
    return parse_verb("serve", [str(word) for word in words])


TEXT = """
streams = ["a.swz", "b.swz"]
page = 8080
public_url = "https://example.org"
origins = ["https://one.example", "https://two.example"]
rate = 2.5
insecure = true
quic = false
"""


def test_a_file_gives_the_same_options_as_the_command_line(file):
    path = file(TEXT)
    found = parsed("--config", path)
    words = ["a.swz", "b.swz", "--page", 8080, "--public-url", "https://example.org", "--rate", 2.5, "--insecure"]
    origins = ["--origins", "https://one.example", "https://two.example"]
    assert found == parsed(*words, *origins, f"--config={path}")
    assert found.trust.insecure
    assert not found.quic


def test_options_of_the_command_line_win(file):
    path = file(TEXT)
    found = parsed("c.swz", "--config", path, "--page", 9090, "--quic", "--port", 4840, "--insecure")
    assert found.streams == ("c.swz",)
    assert (found.page, found.quic, found.rate) == (9090, True, 2.5)
    assert parsed("--config", file("port = 5000"), "--port", 4840).port == 4840


def test_former_names_of_options_work_in_files_and_on_the_command_line(file, capsys):
    current = parsed("a.swz", "--init-repair", 0.5)
    assert parsed("--config", file('streams = ["a.swz"]\nside-repair = 0.5')).init_repair == current.init_repair
    assert parsed("a.swz", "--side-repair", 0.5) == current
    assert capsys.readouterr().err.count("--side-repair is now --init-repair") == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("prot = 5", "'prot' is no option of this verb; is it 'port'?"),
        ("config = 'x.toml'", "'config' is no option"),
        ("page = ", "is no TOML file"),
        ("page = " + "[" * 5000, "is no TOML file"),
        ("page = {a = 1}", "'page' is text, a number"),
        ("streams = [true]", "'streams' is text, a number"),
        ("[server]\nport = 1", "'server' is no option"),
        ('streams = ["a\\u0000b"]', "the value of 'streams' contains a zero byte"),
    ],
)
def test_mistakes_in_the_file_are_one_error_line(run, file, text, message):
    done = run("serve", "--config", file(text))
    assert done.status == 2
    assert message in done.err
    assert len(done.err.splitlines()) == 1


def test_a_missing_file_and_a_wrong_type_are_named(run, file, tmp_path):
    assert "none.toml" in run("serve", "--config", tmp_path / "none.toml").err
    done = run("serve", "--config", file("port = 'high'"))
    assert done.status == 2
    assert "port" in done.err


def test_the_file_in_deploy_is_valid():
    options = parsed("--config", DEPLOY / "serve.toml")
    check_listening(options)
    assert options.over_quic
    assert len(options.streams) == 2
