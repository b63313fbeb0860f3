"""Rollouts on the host: whole transitions at once, groups of episodes that go on, and another backend."""

import subprocess
import sys

import cloudpickle
import gymnasium as gym
import jax
import numpy as np
import pytest

from support import host
from support.comparing import assert_trees_identical
from upslope import GymnasiumTasks, UpslopeError
from upslope.learners.policies import EpsilonGreedy
from upslope.networks.dueling import DuelingQ
from upslope.rollouts import ROLLOUTS, AbstractRollouts, EnvironmentFactory
from upslope.rollouts.rollouts import Trajectories
from upslope.rollouts.vector_rollouts import in_process

ACTIONS = gym.spaces.Discrete(3)


class Clock(gym.Env):
    """Observes the steps taken and the last action. The reward is the task; an odd one is truncated after 3 steps."""

    observation_space = gym.spaces.Box(-100, 100, (2,), np.float32)
    action_space = ACTIONS

    def __init__(self, task):
        self.task = task

    def reset(self, *, seed=None, options=None):
        self.time = 0
        return np.zeros(2, np.float32), {}

    def step(self, action):
        self.time += 1
        done = self.time == 3
        return np.array([self.time, action], np.float32), self.task, done and not self.task % 2, done, {}


def act(step, obs):
    return np.full(len(obs), step % 3)


@pytest.fixture
def rollouts():
    backend = in_process(EnvironmentFactory(Clock), Clock.observation_space, ACTIONS)
    yield backend
    backend.close()


def test_whole_transitions_by_environment_and_step(rollouts):
    seen = rollouts.rollout([4, 5], 0, act, 5)
    assert seen.obs.shape == seen.next_obs.shape == (2, 5, 2)
    np.testing.assert_array_equal(seen.action, [[0, 1, 2, 0, 1]] * 2)
    np.testing.assert_array_equal(seen.reward, [[4] * 5, [5] * 5])
    np.testing.assert_array_equal(seen.terminated, [[0, 0, 1, 0, 0], [0] * 5])
    np.testing.assert_array_equal(seen.obs[..., 0], [[0, 1, 2, 0, 1]] * 2)
    np.testing.assert_array_equal(seen.next_obs[..., 0], [[1, 2, 3, 1, 2]] * 2)
    np.testing.assert_array_equal(seen.next_obs[..., 1], [[0, 1, 2, 0, 1]] * 2)
    assert [array.dtype for array in seen] == [np.float32, np.int32, np.float32, np.bool_, np.float32]


def test_returns_are_of_one_episode(rollouts):
    np.testing.assert_array_equal(rollouts.returns([4, 5, 1], 0, act, 10), [12, 15, 3])
    np.testing.assert_array_equal(rollouts.returns([4], 0, act, 2), [8])


def test_a_group_goes_on_where_it_was_left_whatever_runs_in_between(rollouts):
    one, other = rollouts.start([4, 5], 0), rollouts.start([6], 1)
    np.testing.assert_array_equal(rollouts.collect(one, act, 2).obs[..., 0], [[0, 1]] * 2)
    rollouts.rollout([7, 8], 2, act, 4)
    np.testing.assert_array_equal(rollouts.collect(other, act, 1).reward, [[6]])
    np.testing.assert_array_equal(rollouts.collect(one, act, 3).obs[..., 0], [[2, 0, 1]] * 2)
    assert rollouts.knows(one, 2)
    assert rollouts.knows(other, 1)
    assert not rollouts.knows(one, 1)
    rollouts.close()
    assert not rollouts.knows(one, 2)
    assert rollouts.rollout([4], 0, act, 1).reward == 4, "closed ones are made again"


def test_a_group_that_fails_to_start_is_closed():
    class Failing(Clock):
        closed = 0

        def reset(self, **settings):
            if self.task == 2:
                raise UpslopeError("no start")
            return super().reset(**settings)

        def close(self):
            Failing.closed += 1

    rollouts = in_process(EnvironmentFactory(Failing), Clock.observation_space, ACTIONS)
    with pytest.raises(UpslopeError, match="no start"):
        rollouts.start([1, 2], 0)
    assert Failing.closed == 2


def test_seconds_are_those_inside_environments(rollouts):
    assert rollouts.seconds == 0
    rollouts.rollout([1], 0, act, 3)
    first = rollouts.seconds
    assert first > 0
    rollouts.returns([1], 0, act, 3)
    assert rollouts.seconds > first


class Sending(AbstractRollouts):
    """Stands for a backend elsewhere: tasks and results travel as bytes."""

    def __init__(self, *inputs):
        self.calls = []
        self._there = in_process(*inputs)

    @property
    def seconds(self):
        return self._there.seconds

    def rollout(self, *inputs) -> Trajectories:
        return self._call("rollout", *inputs)

    def returns(self, *inputs):
        return self._call("returns", *inputs)

    def start(self, *inputs):
        return self._call("start", *inputs)

    def knows(self, *inputs):
        return self._call("knows", *inputs)

    def collect(self, *inputs):
        return self._call("collect", *inputs)

    def close(self):
        self._there.close()

    def _call(self, name, *inputs):
        self.calls.append(name)
        # Policies can travel too, but not here: runtime type checks hang weak references on their functions.
        sent = [value if callable(value) else cloudpickle.loads(cloudpickle.dumps(value)) for value in inputs]
        return cloudpickle.loads(cloudpickle.dumps(getattr(self._there, name)(*sent)))


def test_a_backend_elsewhere_needs_one_line_and_gives_the_same(monkeypatch):
    monkeypatch.setitem(ROLLOUTS, "sending", Sending)
    settings = {"name": "cartpole", "observation_scale": host.SCALE}
    here, there = (
        GymnasiumTasks(host.length, host.short_pole, 0.9, mode=mode, **settings) for mode in ROLLOUTS if mode != "async"
    )
    policy = EpsilonGreedy(DuelingQ(jax.random.key(0), 4, 2, (8, 8), host.SCALE, "tanh"), 0.3)

    def experience(family):
        tasks = family.sample_many(jax.random.key(1), 3)
        running = family.reset(jax.random.key(2), tasks)
        running, first = family.collect(jax.random.key(3), tasks, running, policy, 20)
        _, second = family.collect(jax.random.key(4), tasks, running, policy, 20)
        of_one_episode = family.returns(jax.random.key(5), tasks, policy)
        return first, second, family.rollout(jax.random.key(6), tasks, policy, 20), of_one_episode

    assert_trees_identical(experience(there), experience(here))
    assert there.rollouts.calls == ["start", "knows", "collect", "knows", "collect", "returns", "rollout"]


POLICY = """
import cloudpickle, jax, numpy as np
from upslope.learners.policies import EpsilonGreedy
from upslope.networks.dueling import DuelingQ
policy = EpsilonGreedy(DuelingQ(jax.random.key(0), 4, 2, (8, 8)), 0.5)
act = policy.on_host(jax.random.split(jax.random.key(1), 6), 5)()
sent = cloudpickle.loads(cloudpickle.dumps(act))
obs = np.random.default_rng(0).normal(size=(6, 5, 4)).astype(np.float32)
np.testing.assert_array_equal([sent(step, one) for step, one in enumerate(obs)], [act(*one) for one in enumerate(obs)])
"""


def test_policies_can_be_sent_to_other_processes():
    done = subprocess.run([sys.executable, "-c", POLICY], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_an_unknown_mode():
    with pytest.raises(UpslopeError, match="mode is 'ray': give 'sync' or 'async'"):
        GymnasiumTasks(host.length, host.pole, 0.9, mode="ray")


def test_simulators_load_no_jax():
    program = "import sys, upslope.rollouts, upslope.rollouts.task_slot; sys.exit('jax' in sys.modules)"
    subprocess.run([sys.executable, "-c", program], check=True)


class TestKeptEnvironments:
    """A factory that can give tasks builds one environment for each place."""

    def counting(self, give_task):
        made = []

        def make_env(task):
            made.append(task)
            return Clock(task)

        return in_process(EnvironmentFactory(make_env, give_task), Clock.observation_space, ACTIONS), made

    def test_they_are_built_once_for_each_place_and_give_the_same_transitions(self):
        kept, made = self.counting(lambda env, task: setattr(env, "task", task))
        rebuilt, made_again = self.counting(None)
        for tasks in ([4, 5], [7, 8], [9, 6]):
            for one, other in zip(kept.rollout(tasks, 0, act, 5), rebuilt.rollout(tasks, 0, act, 5), strict=True):
                np.testing.assert_array_equal(one, other)
            np.testing.assert_array_equal(kept.returns(tasks, 0, act, 9), rebuilt.returns(tasks, 0, act, 9))
        assert made == [4, 5]
        assert made_again == [4, 5, 4, 5, 7, 8, 7, 8, 9, 6, 9, 6]

    def test_a_task_that_can_not_be_given_is_named(self):
        def refuse(env, task):
            raise KeyError("no such task")

        rollouts, _ = self.counting(refuse)
        rollouts.rollout([4], 0, act, 1)
        with pytest.raises(UpslopeError, match=r"set_task failed for the task 5 \(KeyError: 'no such task'\)"):
            rollouts.rollout([5], 0, act, 1)
