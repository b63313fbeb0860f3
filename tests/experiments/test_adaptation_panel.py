"""The left panel: how step sizes are selected, and what is kept of its runs."""

import gc
import weakref

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from upslope.adaptation.algorithm2 import AdaptationConfig
from upslope.experiments import adaptation_panel as module
from upslope.experiments.adaptation_panel import RULES, AdaptationPanel, Tuning, adaptation_panel
from upslope.experiments.priors import Priors, blank_priors
from upslope.meta_training.config import MetaTrainingConfig
from upslope.run.outcome import Outcome
from upslope.tasks import cartpoles


class TestTuning:
    def test_every_step_size_is_tried_on_the_same_tasks(self) -> None:
        tuning = Tuning((0.1, 0.2, 0.4), test_tasks=7)
        assert tuning.task.tolist() == [0, 0, 0, 1, 1, 1, 2]
        assert tuning.sizes.tolist() == [0.1, 0.2, 0.4, 0.1, 0.2, 0.4, 0.1]
        tasks = tuning.tasks_of_learners({"length": np.arange(7) + 10})
        assert tasks["length"].tolist() == [10, 10, 10, 11, 11, 11, 12]

    def test_all_step_sizes_share_the_keys_of_a_task(self) -> None:
        keys = jax.random.split(jax.random.key(0), (2, 3, 7))
        own = jax.random.key_data(Tuning((0.1, 0.2, 0.4), test_tasks=7).keys_of_learners(keys))
        np.testing.assert_array_equal(own, jax.random.key_data(keys)[:, :, jnp.asarray([0, 0, 0, 1, 1, 1, 2])])

    def test_the_run_that_is_left_over_is_not_counted(self) -> None:
        scores = np.arange(2 * 7 * 4.0).reshape(2, 1, 7, 4)
        by_step_size = Tuning((0.1, 0.2, 0.4), test_tasks=7).by_step_size(scores)
        assert by_step_size.shape == (2, 1, 2, 3, 4)
        np.testing.assert_array_equal(by_step_size[1, 0, 1, 2], scores[1, 0, 5])

    def test_with_fewer_tasks_than_sizes_all_sizes_are_tried_on_one(self) -> None:
        tuning = Tuning((0.1, 0.2, 0.4), test_tasks=2)
        assert (tuning.learners, tuning.task.tolist()) == (3, [0, 0, 0])


class States:
    """The learners' states are dropped: on maps they are gigabytes."""


@pytest.mark.slow
def test_states_of_finished_runs_are_let_go(monkeypatch):
    family, config = cartpoles(), MetaTrainingConfig(hidden=(4,))
    priors = Priors(
        blank_priors(family, config, 2), blank_priors(family, config, 2, 1), np.zeros(1), np.zeros((2, 1)), np.zeros(2)
    )
    made: list[weakref.ref] = []

    def run(learners, keys, *, updates, every, **_):
        gc.collect()
        assert not [number for number, states in enumerate(made) if states() is not None]
        states = States()
        made.append(weakref.ref(states))
        reports = {"return": np.zeros((*keys.shape, updates + 1))}
        return Outcome(states, keys.shape, np.arange(updates + 1), np.zeros(updates + 1), reports, {}, 0.0, 0.0, 0)

    monkeypatch.setattr(module, "run", run)
    tasks = family.sample_many(jax.random.key(0), 3)
    panel = AdaptationPanel(stops=(0,), updates=2, step_sizes=(0.1, 0.2))
    found = adaptation_panel(family, priors, tasks, panel, AdaptationConfig(), 0)
    assert list(found.arms) == list(RULES)
    assert len(made) == 1 + 2 * len(RULES)
