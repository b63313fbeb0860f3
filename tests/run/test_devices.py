"""Learners spread over one, two and four virtual devices learn the same."""

import functools
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]

PROGRAM = """
import json, sys
from dataclasses import replace
import jax
jax.config.update("jax_num_cpu_devices", int(sys.argv[1]))
import numpy as np
from upslope.learners.dqn import DQN, DQNConfig
from upslope.learners import sharing
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.posteriors import NetworkPosterior, TablePosterior
from upslope.run.loop import broadcast, run
from upslope.tasks import cartpoles, obstacle_maps

GRIDS = dict(posterior=TablePosterior(inner_steps=3, inner_step_size=1.0, environments=2), hidden=(8, 8))
ONE_BY_ONE = NetworkPosterior(batch_size=8, task_by_task=True)
CONVOLUTIONS = dict(posterior=ONE_BY_ONE, hidden=(8, 8), outer_optimiser="sgd", outer_step_size=0.05)
family = cartpoles(max_steps=20)
keys = jax.random.split(jax.random.key(0), 7)
config = MetaTrainingConfig(
    iterations=4, tasks=2, steps_per_task=10, posterior=NetworkPosterior(batch_size=8), outer_updates=2,
    evaluation_tasks=1, evaluation_episodes=1,
)
meta = run(broadcast(MetaTraining(family, config), (7,)), keys, updates=4, every=2)
small = DQNConfig(batch_size=8, warmup_steps=8, replay_capacity=32, evaluation_episodes=1)
tasks = family.sample_many(jax.random.key(1), 7)
dqn = run(DQN(family, tasks, None, small), keys, updates=10, every=5)
found = {}
for name, outcome in (("meta", meta), ("dqn", dqn)):
    found[name] = {"returns": outcome.reports["return"].tolist()}
    found[name] |= {metric: values.tolist() for metric, values in outcome.metrics.items()}
found["average"] = [np.asarray(leaf).ravel().tolist() for leaf in jax.tree.leaves(meta.states.average)]
found["network"] = [np.asarray(leaf).ravel().tolist() for leaf in jax.tree.leaves(dqn.states.network)]
found["devices"] = len(meta.flat_states.key.sharding.device_set)
# The first two share a learner's tasks as on devices that are no CPU cores; the last one always does. It has no Adam,
# which makes large steps of gradients that are only rounding errors.
usual, MetaTraining.most_devices = MetaTraining.most_devices, lambda self, n: sharing.most_devices(self.config.tasks, n)
FAMILIES = {"poles": (cartpoles(max_steps=20), {}), "maps": (obstacle_maps("train"), GRIDS),
            "convolutions": (obstacle_maps("train"), CONVOLUTIONS)}
for name, (family, of_grids) in FAMILIES.items():
    if name == "convolutions":
        MetaTraining.most_devices = usual
    shared = replace(config, tasks=4, **of_grids)
    one = run(broadcast(MetaTraining(family, shared), (1,)), keys[:1], updates=4, every=2)
    found[name] = {"returns": one.reports["return"].tolist()}
    found[name] |= {metric: values.tolist() for metric, values in one.metrics.items()}
    found[name]["theta"] = [np.asarray(leaf).ravel().tolist() for leaf in jax.tree.leaves(one.states.theta)]
    found[name]["devices"] = len(one.flat_states.key.sharding.device_set)
print(json.dumps(found))
"""


@functools.cache
def learned_on(devices):
    command = [sys.executable, "-c", PROGRAM, str(devices)]
    environment = os.environ | {"JAX_PLATFORMS": "cpu"}
    done = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads(done.stdout.splitlines()[-1])


@pytest.fixture(scope="module")
def alone():
    return learned_on(1)


@pytest.mark.parametrize("devices", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_as_on_one_device(devices, alone):
    """Seven learners are padded to eight."""
    spread = learned_on(devices)
    assert (alone["devices"], spread["devices"]) == (1, devices)
    assert spread.keys() == alone.keys()
    for name in ("meta", "dqn"):
        assert spread[name].keys() == alone[name].keys()
        for metric, values in alone[name].items():
            np.testing.assert_allclose(spread[name][metric], values, rtol=1e-4, atol=1e-5, err_msg=f"{name}, {metric}")
    for name in ("average", "network"):
        for found, expected in zip(spread[name], alone[name], strict=True):
            np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("devices", [2, pytest.param(4, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ["poles", "maps", "convolutions"])
def test_one_learner_whose_tasks_are_shared(devices, name, alone):
    """Four tasks on as many devices as there are: their gradients are averaged."""
    shared, expected = learned_on(devices)[name], alone[name]
    assert (expected["devices"], shared["devices"]) == (1, devices)
    for found, other in zip(shared["theta"], expected["theta"], strict=True):
        np.testing.assert_allclose(found, other, rtol=1e-3, atol=1e-5)
    assert shared.keys() == expected.keys()
    for metric in expected.keys() - {"devices", "theta"}:
        np.testing.assert_allclose(shared[metric], expected[metric], rtol=1e-4, atol=1e-5, err_msg=metric)


def test_it_learned_something(alone):
    losses = np.asarray(alone["meta"]["outer_loss"])
    assert losses.shape == (7, 3)
    assert (losses[:, 1:] > 0).all()
    assert len({tuple(row) for row in alone["dqn"]["td_loss"]}) == 7, "every learner has its own key"
