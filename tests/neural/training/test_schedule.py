import dataclasses
import inspect
import math

import pytest

from scenes import tiny_causal_scene
from splatwire.cli.train import Train
from splatwire.neural.training.config import LearningRate, LearningRates, Milestones
from splatwire.neural.training.finetune import fine_tuning_config
from splatwire.neural.training.presets import create_config
from splatwire.neural.training.schedule import (
    Phase,
    changes_anchors,
    gathers_statistics,
    learning_rate_at,
    learning_rates,
    phase_of,
)
from splatwire.neural.training.size import measuring_start


def test_size_control_and_iterations_for_losses_are_as_the_help_of_train_states() -> None:
    stated = " ".join(inspect.getsource(Train).split())
    assert "adjusted after 42 % of --iterations, or from the start if --init continues a finished scene." in stated
    assert "--loss adds 30 % to a new training of the model causal;" in stated
    iterations, losses = 24_000, ("bernoulli:0.2",)
    for model, num_iterations in (("causal", 31_200), ("hacpp", 24_000)):
        config = create_config(model=model, iterations=iterations, packet_losses=losses)
        assert config.milestones.iterations == num_iterations
        assert measuring_start(config.milestones) / iterations == pytest.approx(0.42, abs=0.005)
    continued = fine_tuning_config(create_config(iterations=iterations, packet_losses=losses), tiny_causal_scene())
    assert continued.milestones.iterations == iterations
    assert measuring_start(continued.milestones) < 1


def test_phases_equal_the_published_schedule() -> None:
    marks = Milestones()
    changes = {i: phase_of(marks, i) for i in (1, 3000, 3001, 10_000, 10_001, 30_000)}
    expected = [Phase.PLAIN, Phase.PLAIN, Phase.NOISE, Phase.NOISE, Phase.CONTEXT, Phase.CONTEXT]
    assert list(changes.values()) == expected


def test_growth_has_pauses_and_an_end() -> None:
    marks = Milestones()
    events = [i for i in range(1, 30_001) if changes_anchors(marks, i)]
    assert events[0] == 1600
    assert events[-1] == 14_900
    assert all(i % 100 == 0 and not 3000 <= i < 4000 for i in events)
    assert 2900 in events
    assert 4000 in events
    assert not gathers_statistics(marks, 500)
    assert gathers_statistics(marks, 501)
    assert not gathers_statistics(marks, 15_000)


def test_learning_rates_decay_exponentially() -> None:
    rate = LearningRate(0.01, 0.0001)
    assert math.isclose(learning_rate_at(rate, 0.0), 0.01)
    assert math.isclose(learning_rate_at(rate, 0.5), 0.001)
    assert math.isclose(learning_rate_at(rate, 1.0), 0.0001)
    assert math.isclose(learning_rate_at(rate, 2.0), 0.0001)


def test_only_offset_and_mask_rates_scale_with_the_scene() -> None:
    config = create_config()
    small, large = (learning_rates(config, 100, extent) for extent in (1.0, 3.0))
    for name, rate in small.items():
        assert large[name] == pytest.approx(rate * (3 if name in ("offsets", "mask_logits") else 1))


def test_resumed_finished_scene_uses_rates_of_the_second_half() -> None:
    plain, longer = create_config(iterations=600), create_config(iterations=600, packet_losses=("bernoulli:0.2",))
    assert (
        longer.milestones.main_iterations,
        longer.milestones.fine_tuning_iterations,
        longer.milestones.iterations,
    ) == (
        600,
        180,
        780,
    )
    assert dataclasses.replace(longer.milestones, iterations=600, fine_tuning_iterations=0) == plain.milestones
    for iteration in (1, 301, 600):
        assert learning_rates(longer, iteration, 1.0) == learning_rates(plain, iteration, 1.0)
    after, end = (learning_rates(longer, iteration, 1.0) for iteration in (601, 780))
    for name, rate in vars(LearningRates()).items():
        if name != "mask_logits":
            assert after[name] == pytest.approx(math.sqrt(rate.initial * rate.final), rel=0.03)
            assert end[name] == pytest.approx(rate.final)
    assert create_config(model="hacpp", packet_losses=("bernoulli:0.2",)).milestones.fine_tuning_iterations == 0
