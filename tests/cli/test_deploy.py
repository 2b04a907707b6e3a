"""Files in deploy/ for systemd and Docker: their commands are valid, and their ports and times agree with them."""

import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from splatwire.cli._listening import check_listening
from splatwire.cli._operations import monitoring_address
from splatwire.cli._parsing import parse_verb
from splatwire.cli._run_serve import limits
from splatwire.cli.serve import Serve

DEPLOY = Path(__file__).parents[2] / "deploy"
UNIT = (DEPLOY / "splatwire.service").read_text(encoding="utf-8")


def options_of(words: list[str]) -> Serve:
    assert words[0] == "serve"
    options = parse_verb("serve", words[1:])
    check_listening(options)
    limits(options)
    return options


def setting(name: str) -> str:
    (found,) = re.findall(rf"^{name}=((?:.*\\\n)*.*)$", UNIT, re.MULTILINE)
    return found.replace("\\\n", " ")


def test_systemd_unit_runs_a_valid_command_and_waits_for_its_transfers():
    program, *words = shlex.split(setting("ExecStart"))
    options = options_of(words)
    assert program == "/opt/splatwire/bin/splatwire"
    assert 0 < options.drain < float(setting("TimeoutStopSec"))
    credentials = {line.split(":")[0] for line in re.findall(r"^LoadCredential=(.*)$", UNIT, re.MULTILINE)}
    assert {options.certificate.name, options.key.name} == credentials
    assert options.over_quic
    assert options.public_url is not None


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")
def test_systemd_accepts_the_unit(tmp_path: Path):
    unit = tmp_path / "splatwire.service"
    unit.write_text(UNIT.replace("/opt/splatwire/bin/splatwire", shutil.which("true") or "/bin/true"))
    words = ["systemd-analyze", "verify", "--man=no", str(unit)]
    found = subprocess.run(words, capture_output=True, text=True, timeout=600, check=False)
    assert (found.returncode, [line for line in found.stderr.splitlines() if unit.name in line]) == (0, [])


def test_compose_file_runs_a_valid_command_and_publishes_its_ports():
    yaml = pytest.importorskip("yaml", reason="the package pyyaml is not installed")
    (service,) = yaml.safe_load((DEPLOY / "compose.yaml").read_text(encoding="utf-8"))["services"].values()
    options = options_of(service["command"])
    host, port = monitoring_address(options.monitor)
    assert service["ports"] == [f"{options.port}:{options.port}/udp", f"{options.page}:{options.page}/tcp"]
    assert (service["expose"], host) == ([str(port)], "0.0.0.0")
    assert f"http://127.0.0.1:{port}/readyz" in service["healthcheck"]["test"][-1]
    assert 0 < options.drain < float(service["stop_grace_period"].removesuffix("s"))
    assert [path.split(":")[1] for path in service["volumes"]] == [str(Path(options.streams[0]).parent)]
