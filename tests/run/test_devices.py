"""Learners spread over one, two and four devices learn the same."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest

from upslope.learners import sharing
from upslope.learners.dqn import DQN, DQNConfig
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.posteriors import NetworkPosterior, TablePosterior
from upslope.run.loop import broadcast, run
from upslope.tasks import cartpoles, obstacle_maps

ROOT = Path(__file__).parents[2]
POLES = cartpoles(max_steps=20)
SMALL = MetaTrainingConfig(
    iterations=4, tasks=2, steps_per_task=10, posterior=NetworkPosterior(batch_size=8), outer_updates=2,
    evaluation_tasks=1, evaluation_episodes=1,
)  # fmt: skip
GRIDS = {"posterior": TablePosterior(inner_steps=3, inner_step_size=1.0, environments=2), "hidden": (8, 8)}
#: Without Adam, which makes large steps of gradients that are only rounding errors.
CONVOLUTIONS = {
    "posterior": NetworkPosterior(batch_size=8, task_by_task=True), "hidden": (8, 8), "outer_optimiser": "sgd",
    "outer_step_size": 0.05,
}  # fmt: skip


def algorithm_1(learners):
    keys = jax.random.split(jax.random.key(0), learners)
    outcome = run(broadcast(MetaTraining(POLES, SMALL), (learners,)), keys, updates=4, every=2)
    return outcome, outcome.states.average


def dqn(learners):
    """Different tasks and keys."""
    keys, tasks = jax.random.split(jax.random.key(0), learners), POLES.sample_many(jax.random.key(1), learners)
    small = DQNConfig(batch_size=8, warmup_steps=8, replay_capacity=32, evaluation_episodes=1)
    outcome = run(DQN(POLES, tasks, None, small), keys, updates=10, every=5)
    return outcome, outcome.states.network


def shared(family, **changes):
    """One learner of four tasks."""
    config = replace(SMALL, tasks=4, **changes)
    outcome = run(broadcast(MetaTraining(family, config), (1,)), jax.random.key(0)[None], updates=4, every=2)
    return outcome, outcome.states.theta


JOBS = {
    "Algorithm 1": lambda: algorithm_1(7),
    "DQN": lambda: dqn(7),
    "three DQNs": lambda: dqn(3),
    "shared poles": lambda: shared(POLES),
    "shared maps": lambda: shared(obstacle_maps("train"), **GRIDS),
    "shared convolutions": lambda: shared(obstacle_maps("train"), **CONVOLUTIONS),
}


def learn(name):
    """What one job reports, and how many devices it ran on; plain lists."""
    with pytest.MonkeyPatch.context() as patch:
        if name in ("shared poles", "shared maps"):
            # CPU devices share one learner's tasks only with convolutions; others always do.
            patch.setattr(MetaTraining, "most_devices", lambda self, n: sharing.most_devices(self.config.tasks, n))
        outcome, network = JOBS[name]()
    leaves = [np.asarray(leaf).ravel().tolist() for leaf in jax.tree.leaves(network)]
    metrics = {metric: np.asarray(values).tolist() for metric, values in outcome.metrics.items()}
    metrics["return"] = outcome.reports["return"].tolist()
    return {"devices": len(outcome.flat_states.key.sharding.device_set), "network": leaves, "metrics": metrics}


def learn_elsewhere(name, devices):
    """The same in a process with its own number of devices."""
    program = (
        f"import jax, json; jax.config.update('jax_num_cpu_devices', {devices}); "
        f"from tests.run.test_devices import learn; print(json.dumps(learn({name!r})))"
    )
    environment = os.environ | {"JAX_PLATFORMS": "cpu", "PYTHONPATH": f"{ROOT}:{os.environ.get('PYTHONPATH', '')}"}
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads(done.stdout.splitlines()[-1])


def assert_same(found, expected):
    assert found["metrics"].keys() == expected["metrics"].keys()
    for metric, values in expected["metrics"].items():
        np.testing.assert_allclose(found["metrics"][metric], values, rtol=1e-4, atol=1e-5, err_msg=metric)
    for ours, theirs in zip(found["network"], expected["network"], strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-3, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("name", JOBS)
def test_two_devices_as_one(name, monkeypatch):
    """Seven learners are padded to eight, three to four; four tasks of one learner are shared."""
    spread = learn(name)
    first = jax.local_devices()[:1]
    monkeypatch.setattr(jax, "local_devices", lambda: first)
    alone = learn(name)
    assert (alone["devices"], spread["devices"]) == (1, 2)
    assert_same(spread, alone)
    losses = np.asarray(next(values for metric, values in alone["metrics"].items() if metric.endswith("loss")))
    assert (losses[:, 1:] > 0).all(), "nothing was learned"
    assert len({tuple(row) for row in losses}) == len(losses), "every learner has its own key"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["Algorithm 1", "DQN", "shared poles", "shared maps", "shared convolutions"])
def test_four_devices_as_one(name):
    spread, alone = learn_elsewhere(name, 4), learn_elsewhere(name, 1)
    assert (alone["devices"], spread["devices"]) == (1, 4)
    assert_same(spread, alone)
