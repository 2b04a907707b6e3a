"""Registries: entries of installed packages are found by name, and broken packages are named in one sentence."""

import logging
import subprocess
import sys

import numpy as np
import pytest

from distributions import announce
from splatwire.channel import parse_loss, register_loss_model
from splatwire.channel.registry import LOSS_MODELS
from splatwire.errors import InvalidValueError, UnknownNameError
from splatwire.metrics import register_metric
from splatwire.metrics.registry import METRICS, measure_view
from splatwire.plugins import Registry

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def restored(monkeypatch):
    """Puts the registries of loss models and metrics back after each test."""
    for registry in (LOSS_MODELS, METRICS):
        for name in ("_entries", "_sources"):
            monkeypatch.setattr(registry, name, dict(getattr(registry, name)))


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Installs a package of one module that announces entries of the group `toys.things`."""
    monkeypatch.syspath_prepend(tmp_path)

    def put(name: str, points: dict[str, str], module: str = "", group: str = "toys.things") -> None:
        (tmp_path / f"{name}.py").write_text(module, encoding="utf-8")
        announce(tmp_path, {"name": name, "version": "3", "entry-points": {group: points}})
        monkeypatch.delitem(sys.modules, name, raising=False)

    return put


def toys() -> Registry[str]:
    registry: Registry[str] = Registry("toy", "toys.things")
    registry.register("ball", "round", "splatwire.toys.Ball")
    sys.modules["toy_box"] = type(sys)("toy_box")
    sys.modules["toy_box"].__dict__["REGISTRY"] = registry
    return registry


REGISTERS = "from toy_box import REGISTRY\nREGISTRY.register('{name}', 'x', __name__ + '.Toy')\nclass Toy: pass\n"


def test_registered_name_is_found_without_reading_entry_points(install):
    install("acme_broken_a", {"kite": "acme_broken_a:Toy"}, "raise OSError('no disk')")
    registry = toys()
    assert registry["ball"] == "round"
    assert "acme_broken_a" not in sys.modules


def test_name_of_an_installed_package_is_loaded_when_it_is_needed(install):
    install("acme_kites", {"kite": "acme_kites:Toy"}, REGISTERS.format(name="kite"))
    registry = toys()
    assert registry.known_names() == {"ball", "kite"}
    assert "acme_kites" not in sys.modules
    assert registry["kite"] == "x"
    assert registry.packages("kite") == ("acme_kites 3",)
    assert registry.packages("ball") == ()
    with pytest.raises(UnknownNameError, match="unknown toy 'train': known are ball, kite"):
        registry["train"]


@pytest.mark.parametrize(
    ("module", "sentence"),
    [
        ("import nowhere_at_all", "toy 'kite' of acme_bad_{n} cannot be loaded: No module named 'nowhere_at_all'"),
        ("import sys\nsys.exit(3)", "toy 'kite' of acme_bad_{n} cannot be loaded: 3"),
        ("x = 1", "toy 'kite' of acme_bad_{n} cannot be loaded: module 'acme_bad_{n}' has no attribute 'Toy'"),
        ("class Toy: pass", "acme_bad_{n} announces toy 'kite' and does not register it"),
        (REGISTERS.format(name="ball"), "cannot be loaded: two toys are called 'ball': splatwire.toys.Ball and acme_b"),
        (REGISTERS.format(name="a:b"), "'a:b' cannot be the name of a toy"),
        ("def Toy(: pass", "toy 'kite' of acme_bad_{n} cannot be loaded: invalid syntax"),
    ],
)
def test_broken_package_is_an_error_on_use_and_a_warning_in_lists(install, caplog, module, sentence):
    number = abs(hash(module))
    sentence = sentence.format(n=number)
    install(f"acme_bad_{number}", {"kite": f"acme_bad_{number}:Toy"}, module)
    registry = toys()
    with pytest.raises(InvalidValueError) as raised:
        registry["kite"]
    assert sentence in str(raised.value)
    assert f"acme_bad_{number}" in str(raised.value)
    with caplog.at_level(logging.WARNING):
        assert list(registry.all()) == ["ball"]
        registry.all()
    assert caplog.text.count(sentence) == 1


def test_duplicate_name_keeps_the_first_entry_with_a_warning(install, caplog):
    install("acme_taker", {"ball": "acme_taker:Toy"}, REGISTERS.format(name="ball"))
    registry = toys()
    with caplog.at_level(logging.WARNING):
        assert registry.all() == {"ball": "round"}
    assert "acme_taker announces toy 'ball': splatwire.toys.Ball has the name, which stays" in caplog.text


def test_one_name_of_two_packages_is_refused(install):
    for name in ("acme_one", "acme_two"):
        install(name, {"kite": f"{name}:Toy"}, REGISTERS.format(name="kite"))
    with pytest.raises(InvalidValueError, match=r"acme_\w+ and acme_\w+ announce a toy 'kite': uninstall all but one"):
        toys()["kite"]


def test_explicit_registration_replaces_an_earlier_entry(caplog):
    registry = toys()
    registry.register("kite", "theirs", "acme.Kite")
    with caplog.at_level(logging.WARNING):
        registry.register("kite", "ours", "splatwire.toys.Kite")
    assert registry["kite"] == "ours"
    assert "two toys are called 'kite': acme.Kite and splatwire.toys.Kite, which is kept" in caplog.text


def test_built_in_names_need_no_entry_points():
    code = (
        "import sys\nfrom splatwire.channel import parse_loss\nfrom splatwire.metrics.registry import METRICS\n"
        "parse_loss('gilbert:0.2,3'), METRICS['psnr']\n"
        "from splatwire import plugins\nsys.exit(plugins._entry_points.cache_info().misses)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_loss_model_is_made_from_its_text_and_checked():
    made = []

    @register_loss_model("coin", form="coin:SIDE")
    def coin(text, *, unit):
        made.append((text, unit))
        side = int(text)
        received = {1: lambda self, n, rng: rng.random(n) > 0.5, 2: lambda self, n, rng: [1] * n}[side]
        return type("Coin", (), {"name": f"coin:{text}", "unit": unit, "received": received})()

    assert parse_loss("coin:1", "datagram").received(5, np.random.default_rng(0)).shape == (5,)
    assert made == [("1", "datagram")]
    with pytest.raises(InvalidValueError, match="'coin:head' should look like coin:SIDE: invalid literal"):
        parse_loss("coin:head")
    with pytest.raises(InvalidValueError, match=r"loss model 'coin:2' returned int64 of shape \(3,\), not 3 booleans"):
        parse_loss("coin:2").received(3, np.random.default_rng(0))
    register_loss_model("void")(lambda text, *, unit: object())  # type: ignore[type-var]
    with pytest.raises(InvalidValueError, match="loss model 'void' is no loss model: it has no name, received, unit"):
        parse_loss("void:3")
    with pytest.raises(UnknownNameError, match=r"known are bernoulli:RATE, coin:SIDE, gilbert:RATE,BURST, none, trace"):
        parse_loss("dice:3")


@pytest.mark.parametrize("result", [0.5, [0.5, 0.5], ["a"], [float("nan")]])
def test_metric_that_returns_no_number_for_a_view_is_one_error(result):
    picture = np.zeros((1, 2, 2, 3), np.float32)
    register_metric("odd")(lambda images, references, masks: result)
    with pytest.raises(InvalidValueError, match=r"metric 'odd' returned .* for one view, not a number"):
        measure_view("odd", picture, picture, None)


def test_metric_needs_a_name_that_can_be_a_column():
    with pytest.raises(InvalidValueError, match="'a-b' cannot be the name of a metric"):
        register_metric("a-b")(len)
