"""Manual page and shell completion, made from the parser."""

import shutil
import subprocess

import pytest

from splatwire.cli._verbs import VERBS

BASH = shutil.which("bash")
GROFF = shutil.which("groff")


@pytest.fixture(scope="module")
def page():
    from splatwire.cli._manual import manual_page

    return manual_page()


def test_the_manual_has_every_verb_and_its_options(run, page):
    assert run("--manual").out == page
    for name, verb in VERBS.items():
        assert f"\n.B {name}\n" in page
        assert f'\n.SH "SPLATWIRE {name.upper()}"\n' in page
        assert verb.help.split()[0] in page
    serve = page[page.index('.SH "SPLATWIRE SERVE"') : page.index('.SH "SPLATWIRE TOKEN"')]
    for option in ("private", "total\\-rate", "certificate", "json"):
        assert f"\\-\\-{option}" in serve


def test_no_line_of_the_manual_has_frames_or_wrong_control_characters(page):
    known = {".TH", ".SH", ".B", ".TP", ".PP", ".nf", ".fi"}
    for line in page.splitlines():
        assert line.isascii(), line
        assert not line.startswith("'"), line
        assert not line.startswith(".") or line.split()[0] in known, line


@pytest.mark.skipif(GROFF is None, reason="groff is not installed")
def test_groff_formats_the_manual_without_warnings(page):
    command = [GROFF, "-man", "-Tascii", "-ww", "-P-cbou"]
    done = subprocess.run(command, input=page.encode("ascii"), capture_output=True, timeout=600)
    assert done.returncode == 0
    assert done.stderr == b""
    text = done.stdout.decode()
    assert "codec and streaming of 3D Gaussian splats" in text
    assert "--token-key PATH" in text


@pytest.mark.skipif(BASH is None, reason="bash is not installed")
def test_bash_completes_verbs_and_options(run, tmp_path):
    (tmp_path / "completion").write_text(run("--tyro-print-completion", "bash").out)
    script = """
source completion
complete -p splatwire > spec
function=$(sed 's/.*-F \\([^ ]*\\).*/\\1/' spec)
completed() { COMP_WORDS=("$@") COMP_CWORD=$(($# - 1)); COMPREPLY=(); $function; printf '%s\\n' "${COMPREPLY[@]}"; }
completed splatwire de
echo
completed splatwire serve --tok
"""
    done = subprocess.run(
        [str(BASH), "--norc", "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=600
    )
    verbs, options = done.stdout.split("\n\n")
    assert {"demo", "decode"} == set(verbs.split()), done.stderr
    assert options.split() == ["--token-key"], done.stderr
