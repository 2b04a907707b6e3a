import os

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from splatwire.files.names import distinct_names, safe_name

NAMES = st.text(st.characters() | st.sampled_from("aAbÄß_. /\\\0"), max_size=120)


@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])  # on a busy machine, too
@given(st.lists(NAMES | st.sampled_from(["a b", "a_b", "A_B", "a_b_2", "straße", "STRASSE"]), max_size=12))
def test_names_are_distinct_and_safe(names):
    found = distinct_names(names)
    assert len({name.casefold() for name in found}) == len(names)
    for name in found:
        assert name
        assert os.path.basename(name) == name
        assert not name.startswith(".")
        assert len(name.encode()) <= 230


def test_safe_distinct_names_are_unchanged():
    assert distinct_names(["a", "b.c", "Ä-1"]) == ("a", "b.c", "Ä-1")
    assert distinct_names(["a b", "a_b", "a_b", "a_b_2"]) == ("a_b", "a_b_2", "a_b_3", "a_b_2_2")
    assert safe_name("../..", "view") == "view"


def test_unsafe_names_become_distinct_safe_names():
    """File systems differ in separators, case and allowed characters."""
    files = distinct_names(["a b", "a_b", "A/b", "../../sly", "/etc/passwd", "", "..", "ok"])
    assert len({file.lower() for file in files}) == 8
    assert files[:2] == ("a_b", "a_b_2")
    assert files[-1] == "ok"
    assert not any("/" in file or file.startswith(".") or not file for file in files)
