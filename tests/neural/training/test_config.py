import dataclasses
import itertools
import json
import math
from typing import Any

import pytest

from splatwire.errors import InvalidValueError, UnknownNameError
from splatwire.neural.training.checkpoint import config_from_json, record_to_json
from splatwire.neural.training.config import LearningRates, Milestones, TrainConfig
from splatwire.neural.training.gaussians import GaussianConfig
from splatwire.neural.training.loop import RunOptions
from splatwire.neural.training.presets import CAUSAL_LATE, PRESETS, create_config
from splatwire.neural.training.schedule import learning_rates


@pytest.mark.parametrize("preset", PRESETS)
def test_recipe_round_trips_through_json(preset: str) -> None:
    config = create_config(preset, iterations=1234, seed=5)
    plain = json.loads(json.dumps(record_to_json(config)))
    assert config_from_json(plain) == config


def test_configurations_are_stored_under_the_names_of_earlier_checkpoints() -> None:
    stored = record_to_json(create_config(packet_losses=("bernoulli:0.2", "first:0.5"), size=9000))
    assert stored["losses"] == {
        "models": ("bernoulli:0.2",), "first": (0.5,), "packets": ("paper", "datagram"), "share": 0.5
    }  # fmt: skip
    assert (stored["averaged"], stored["weights"]["size"], stored["growth"]["seen_share"]) == (100, 9000, 0.8)
    assert (stored["milestones"]["tuning"], "steps" in stored["rates"]) == (9000, True)
    gaussians = record_to_json(GaussianConfig(packet_loss="bernoulli:0.2"))
    assert (gaussians["tuning"], gaussians["loss"]) == (600, "bernoulli:0.2")


@pytest.mark.parametrize(("old", "new"), [("losses", "packet_loss"), ("averaged", "averaging_iterations")])
def test_deprecated_settings_warn_and_give_the_new_value(old: str, new: str) -> None:
    with pytest.warns(DeprecationWarning, match=f"use {new}"):
        assert getattr(create_config(), old) == getattr(create_config(), new)


def test_presets_hold_the_published_settings() -> None:
    config = create_config("mipnerf360", model="hacpp")
    assert config.weights.rate == 0.004
    assert config.rates.mask_logits.final == 0.0015  # min(.0005 * .004 / .001, .0015)
    assert math.isclose(create_config("tanks_and_temples", model="hacpp", lmbda=0.002).rates.mask_logits.final, 0.0002)
    assert create_config("synthetic_nerf").growth.coarsest_cell == 4
    assert create_config("bungeenerf").test_views == "first_31"
    assert config.milestones == Milestones()


@pytest.mark.parametrize("iterations", [20, 100, 2400, 7000, 30_000, 60_000])
def test_phases_keep_their_proportions(iterations: int) -> None:
    full, scaled = Milestones(), create_config(iterations=iterations).milestones
    for field in dataclasses.fields(Milestones):
        share = getattr(full, field.name) / full.iterations
        if field.name != "growth_interval":
            assert abs(getattr(scaled, field.name) / iterations - share) <= 0.5 / iterations
    order = [scaled.noise_start, scaled.growth_pause_end, scaled.context_start, scaled.growth_end, scaled.iterations]
    assert order == sorted(order)
    assert scaled.growth_interval >= 50
    chosen = create_config(iterations=iterations, growth_interval=100).milestones
    assert chosen == dataclasses.replace(scaled, growth_interval=100)


def test_schedule_of_2400_iterations_is_pinned() -> None:
    marks = create_config(iterations=2400).milestones
    assert (marks.statistics_start, marks.growth_start, marks.growth_end, marks.growth_interval) == (40, 120, 1200, 50)
    assert (marks.noise_start, marks.growth_pause_end, marks.context_start) == (240, 320, 800)


def test_short_runs_end_with_larger_learning_rates() -> None:
    runs = [
        create_config(model="hacpp", iterations=iterations).rates for iterations in (60_000, 30_000, 15_000, 2400, 240)
    ]
    assert runs[0] == runs[1] == LearningRates()
    for longer, shorter in itertools.pairwise(runs[1:]):
        assert (shorter.mask_logits, shorter.grid, shorter.prior) == (longer.mask_logits, longer.grid, longer.prior)
        assert shorter.offsets.final > longer.offsets.final
        for before, after in zip(vars(longer).values(), vars(shorter).values(), strict=True):
            assert after.initial == before.initial
            assert before.final <= after.final <= max(before.final, after.initial)


def test_causal_learning_rate_rises_after_growth() -> None:
    runs = [create_config(iterations=iterations) for iterations in (30_000, 15_000, 2400, 240)]
    for name, most in CAUSAL_LATE.items():
        late = [getattr(run.rates, name).late for run in runs]
        assert late[0] == 1
        assert 1 < late[1] < most
        assert late[2:] == [most, most]
    assert runs[2].rates.mask_logits.late == 1
    middle = runs[2].milestones.growth_end
    before, after = (learning_rates(runs[2], middle + step, 1.0) for step in (0, 1))
    assert after["offsets"] == pytest.approx(7 * before["offsets"], rel=1e-3)
    assert after["mask_logits"] == before["mask_logits"]


def test_invalid_settings_are_refused() -> None:
    with pytest.raises(UnknownNameError, match="mipnerf360"):
        create_config("mip")
    for bad in ({"lmbda": -1.0}, {"lmbda": math.nan}, {"voxel_size": -0.1}, {"iterations": 0}, {"growth_interval": 0}):
        with pytest.raises(InvalidValueError):
            create_config(**bad)
    with pytest.raises(InvalidValueError, match="recipe"):
        config_from_json({"milestones": {}})
    plain = json.loads(json.dumps(record_to_json(create_config())))
    for wrong in (
        {**plain, "pace": 1},
        {**plain, "milestones": {}},
        {**plain, "growth": [1]},
        {**plain, "model": None},
    ):
        with pytest.raises(InvalidValueError, match="recipe"):
            config_from_json(wrong)


@pytest.mark.parametrize(
    "values",
    [{"background": (2.0, 0.0, 0.0)}, {"seed": -1}, {"voxel_size": -0.1}, {"averaging_iterations": -1},
     {"random_points": -1}],
)  # fmt: skip
def test_values_out_of_range_are_refused_before_the_training(values: dict[str, Any]) -> None:
    (name,) = values
    with pytest.raises(InvalidValueError, match=name):
        TrainConfig(**values)


def test_a_background_out_of_range_is_refused_for_explicit_gaussians() -> None:
    with pytest.raises(InvalidValueError, match="a background is three numbers from 0 to 1"):
        GaussianConfig(background=(0.0, 0.0, 1.5))


@pytest.mark.parametrize("values", [{"checkpoint_interval": 0}, {"test_interval": -1}, {"max_test_views": 0}])
def test_intervals_out_of_range_are_refused(values: dict[str, int]) -> None:
    (name,) = values
    with pytest.raises(InvalidValueError, match=name):
        RunOptions(**values)  # type: ignore[arg-type]
