"""Invalid input gives one line on standard error, exit status 2 and no output."""

import shutil

import pytest

from splatwire.evaluation.study import inputs


def assert_complains(outcome, *words):
    assert outcome.status == 2
    assert outcome.out == ""
    last = outcome.err.splitlines()[-1]
    assert last.startswith("splatwire: error: ")
    assert "Traceback" not in outcome.err
    for word in words:
        assert str(word) in last


def test_missing_input_is_refused(run, tmp_path):
    for words in (("decode", tmp_path / "x", "-o", tmp_path / "y"), ("inspect", tmp_path / "x")):
        assert_complains(run(*words), tmp_path / "x")


@pytest.mark.parametrize(
    ("words", "where"),
    [
        (("inspect", ""), "after inspect"),
        (("decode", "a.swz", "-o", ""), "after -o"),
        (("render", "a.swz", "--data="), "of --data"),
    ],
)
def test_empty_arguments_are_refused(run, words, where):
    assert_complains(run(*words), f"the argument {where} is empty")


@pytest.mark.needs_torch
def test_wrong_folders_are_one_error_line(run, tmp_path):
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "me.jpg").write_bytes(b"\xff\xd8")
    for verb in ("decode", "transmit"):
        assert_complains(run(verb, tmp_path / "photos", "-o", tmp_path / "out"), tmp_path / "photos")
    assert_complains(run("import", "hacpp", tmp_path / "photos", "-o", tmp_path / "out"), "photos")
    assert not (tmp_path / "out").exists()


def test_a_photo_folder_is_never_overwritten(run, journey, tmp_path):
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "me.jpg").write_bytes(b"\xff\xd8")
    assert_complains(run("transmit", journey / "tiny.swz", "-o", tmp_path / "photos"), "photos")
    assert (tmp_path / "photos" / "me.jpg").exists()


def test_missing_side_information_is_refused(run, journey, tmp_path):
    shutil.copytree(journey / "packets", tmp_path / "a")
    (tmp_path / "a" / "side_info.bin").unlink()
    assert_complains(run("decode", tmp_path / "a", "-o", tmp_path / "x"), "side_info.bin", "missing")


def test_truncated_file_is_an_error_or_a_counted_loss(run, journey, tmp_path):
    data = (journey / "tiny.swz").read_bytes()
    (tmp_path / "cut.swz").write_bytes(data[: len(data) // 2])
    outcome = run("decode", tmp_path / "cut.swz", "-o", tmp_path / "x", "--json")
    assert outcome.status in (0, 2)
    if outcome.status:
        assert_complains(outcome)
    else:
        assert outcome.json["num_lost"] > 0
    (tmp_path / "cut.swz").write_bytes(data[:100])
    assert_complains(run("decode", tmp_path / "cut.swz", "-o", tmp_path / "x"), "cut.swz")


def test_a_flipped_bit_is_a_counted_loss(run, journey, tmp_path):
    shutil.copytree(journey / "packets", tmp_path / "a")
    packet = tmp_path / "a" / "pak_lane1_s0.pak"
    data = bytearray(packet.read_bytes())
    data[-1] ^= 1
    packet.write_bytes(data)
    content = run("decode", tmp_path / "a", "-o", tmp_path / "x", "--json").json
    assert content["packets"]["num_corrupt"] == 1
    assert 0 < content["num_lost"] < 60


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 a zip file", b"{}" * 100])
def test_files_of_another_kind_are_one_error_line(run, tmp_path, content):
    (tmp_path / "a.bin").write_bytes(content)
    for verb in ("decode", "encode", "transmit"):
        assert_complains(run(verb, tmp_path / "a.bin", "-o", tmp_path / "x"), "a.bin")
    assert_complains(run("inspect", tmp_path / "a.bin"), "a.bin")


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--loss", "bernoulli:1.5"), "1.5"),
        (("--loss", "sunshine"), "sunshine"),
        (("--loss", "trace:/nowhere"), "/nowhere"),
        (("--seed", "-1"), "-1"),
        (("--send-order", "random"), "random"),
    ],
)
def test_invalid_transmit_settings_are_refused(run, journey, tmp_path, words, named):
    assert_complains(run("transmit", journey / "tiny.swz", "-o", tmp_path / "x", *words), named)


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--preset", "best"), "best"),
        (("--block-size", "0"), "block size"),
        (("--lanes", "1000"), "lanes"),
    ],
)
def test_invalid_encode_settings_are_refused(run, journey, tmp_path, words, named):
    assert_complains(run("encode", journey / "tiny.scene", "-o", tmp_path / "x", *words), named)


def test_unknown_concealer_is_reported_before_any_work(run, journey, tmp_path):
    assert_complains(run("decode", tmp_path / "none", "-o", tmp_path / "x", "--conceal", "magic"), "magic", "cari")
    words = ("--reference", journey / "tiny.swz", "--cameras", journey / "cameras.json")
    assert_complains(run("evaluate", tmp_path / "none", *words, "--conceal", "magic"), "magic")
    assert_complains(run("evaluate", journey / "tiny.swz", *words, "--renderer", "crayons"), "crayons")
    assert_complains(
        run("evaluate", journey / "tiny.swz", *words, "--loss", "none", "--seeds", 1, 1), "seed 1 is there 2 times"
    )


def test_evaluate_refuses_a_concealer_that_cannot_conceal_losses_of_the_file(run, journey):
    reference = ("--reference", journey / "tiny.swz", "--cameras", journey / "cameras.json")
    outcome = run("evaluate", journey / "tiny.swz", *reference, "--loss", "bernoulli:0.2", "--conceal", "sketch")
    assert_complains(outcome, "tiny: concealer 'sketch' reads the section 'sketch'", "use drop")


def test_evaluate_refuses_a_protocol_and_names_study(run, tmp_path):
    assert_complains(run("evaluate", "table3.toml", "-o", tmp_path), "splatwire study table3.toml")


@pytest.mark.parametrize("words", [("--seeds", 1), ("--contiguous",)])
def test_loss_options_require_the_option_loss(run, journey, words):
    reference = ("--reference", journey / "tiny.swz", "--cameras", journey / "cameras.json")
    assert_complains(run("evaluate", journey / "tiny.swz", *reference, *words), words[0], "--loss")


def test_large_references_that_are_no_scenes_are_refused_before_they_are_hashed(run, journey, tmp_path, monkeypatch):
    with (tmp_path / "large.ply").open("wb") as file:
        file.truncate(20 << 30)  # sparse: nothing is stored

    def digest_of_files(path):
        assert path != tmp_path / "large.ply"
        return digest(path)

    digest = inputs.digest_of_files
    monkeypatch.setattr(inputs, "digest_of_files", digest_of_files)
    words = ("--reference", tmp_path / "large.ply", "--cameras", journey / "cameras.json")
    assert_complains(run("evaluate", journey / "tiny.swz", *words), tmp_path / "large.ply", "not a scene file")


def test_cameras_and_references_must_be_given(run, journey, tmp_path):
    assert_complains(run("evaluate", journey / "tiny.swz"), "--data")
    words = ("--reference", journey / "tiny.swz", "--cameras", journey / "cameras.json", "--data", tmp_path)
    assert_complains(run("evaluate", journey / "tiny.swz", *words), "either --cameras FILE or --data")
    assert_complains(
        run("render", journey / "tiny.scene", "-o", tmp_path, "--cameras", tmp_path / "no.json"), "no.json"
    )


def test_a_lossy_stream_cannot_be_encoded(run, journey, tmp_path):
    run("decode", journey / "lossy.swz", "-o", tmp_path / "gaps.scene")
    assert_complains(run("encode", tmp_path / "gaps.scene", "-o", tmp_path / "x.swz"), "gaps.scene")


def test_json_and_data_cannot_share_standard_output(run, journey):
    assert_complains(run("encode", journey / "tiny.scene", "-o", "-", "--json"), "--json")


@pytest.mark.parametrize("verb", ["encode", "decode", "transmit"])
def test_output_does_not_replace_a_device(run, journey, verb):
    source = journey / ("tiny.scene" if verb == "encode" else "tiny.swz")
    assert_complains(run(verb, source, "-o", "/dev/null"), "/dev/null", "no ordinary file")


def test_file_in_place_of_a_folder_is_reported(run, journey, tmp_path):
    (tmp_path / "notes").write_text("hello")
    assert_complains(run("decode", journey / "tiny.swz", "-o", tmp_path / "notes" / "a"), tmp_path / "notes", "folder")


@pytest.mark.parametrize(
    "words",
    [
        ("encode", "tiny.scene", "-o", "OUT/a.swz"),
        ("transmit", "tiny.swz", "-o", "OUT/packets"),
        ("decode", "tiny.swz", "-o", "OUT/a.scene"),
        ("render", "tiny.scene", "-o", "OUT/pictures", "--cameras", "cameras.json"),
        ("evaluate", "tiny.swz", "--reference", "tiny.scene", "-o", "OUT/report"),
        ("demo", "-o", "OUT/demo"),
        ("export", "ply", "tiny.scene", "-o", "OUT/a.ply"),
        ("calibrate", "sketch", "tiny.swz", "-o", "OUT/a.swz"),
        ("receive", "udp://127.0.0.1:9", "-o", "OUT/a.swz"),
        ("import", "splats", "tiny.swz", "-o", "OUT/a.ply"),
    ],
    ids=lambda words: words[0],
)
def test_no_verb_creates_parent_folders_of_its_output(run, journey, tmp_path, monkeypatch, words):
    monkeypatch.chdir(journey)
    missing = tmp_path / "no" / "such"
    done = run(*(word.replace("OUT", str(missing)) for word in words))
    assert_complains(done, f"{missing}: no such folder")
    assert not missing.parent.exists()


def test_output_folder_is_created_inside_an_existing_folder(run, journey, tmp_path):
    words = (journey / "tiny.scene", "-o", tmp_path / "new", "--cameras", journey / "cameras.json", "--scale", "0.2")
    assert run("render", *words).status == 0
    assert (tmp_path / "new" / "cameras.json").exists()
