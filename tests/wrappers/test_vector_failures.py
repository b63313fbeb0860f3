"""Vector environments that fail inside the vector wrapper: dead workers, and observations that change shape."""

import gc
import os

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv

from support.scripted import EPISODES, GAMMA, Scripted, Walk, level
from upslope import PotentialShaping as Single
from upslope import UpslopeError
from upslope.rollouts.workers import DeadWorkerError, call_workers
from upslope.wrappers.vector import PotentialShaping


class Dying(Walk):
    """Its process exits at the first step."""

    def step(self, action):
        os._exit(1)


class Reshaping(Walk):
    """After the first, its observations are longer by ``more`` coordinates."""

    def __init__(self, more=1):
        self.more = more

    def step(self, action):
        obs, *rest = super().step(action)
        return (np.resize(obs, 2 + self.more), *rest)


class Parts(Scripted):
    """Returns its observation inside a dictionary."""

    observation_space = gym.spaces.Dict({"place": Scripted.observation_space})

    def _obs(self, value):
        return {"place": super()._obs(value)}


class Changing(Parts):
    """Its dictionary changes at the second observation."""

    def __init__(self, changed):
        super().__init__(*EPISODES)
        self.changed = changed

    def step(self, action):
        return (self.changed, *super().step(action)[1:])


class TestDeadWorkers:
    def test_each_call_raises_a_clear_error_and_closing_is_quiet(self):
        env = PotentialShaping(AsyncVectorEnv([Dying, Walk], context="spawn"), level, GAMMA)
        env.reset(seed=0)
        with pytest.raises(UpslopeError, match="worker process of the vector environment died"):
            env.step(np.zeros(2, int))
        assert not any(process.is_alive() for process in env.unwrapped.processes), "no process is left behind"
        for call in (lambda: env.step(np.zeros(2, int)), env.reset):
            with pytest.raises(UpslopeError, match=r"is closed.*make a new one"):
                call()
        env.close()
        assert env.closed
        del env
        gc.collect()  # an exception here would be a warning, and so an error

    def test_closing_works_after_a_worker_died_between_two_steps(self):
        env = PotentialShaping(AsyncVectorEnv([Walk, Walk], context="spawn"), level, GAMMA)
        env.reset(seed=0)
        env.unwrapped.processes[0].kill()
        env.unwrapped.processes[0].join()
        env.close()
        assert env.closed
        assert not any(process.is_alive() for process in env.unwrapped.processes)

    def test_living_workers_are_closed_as_usual(self):
        env = PotentialShaping(AsyncVectorEnv([Walk], context="spawn"), level, GAMMA)
        env.reset(seed=0)
        env.close()
        assert env.closed
        assert env.unwrapped.processes[0].exitcode == 0, "asked to end, not killed"


class TestChangingShapes:
    @pytest.mark.parametrize("more", [1, -1])
    @pytest.mark.parametrize("others", [0, 1])
    def test_in_one_process(self, more, others):
        env = PotentialShaping(SyncVectorEnv([lambda: Reshaping(more)] + [Walk] * others), level, GAMMA)
        env.reset(seed=0)
        with pytest.raises(UpslopeError, match="another shape than its observation space says"):
            env.step(np.zeros(1 + others, int))

    @pytest.mark.filterwarnings("ignore:.*ERROR")  # Gymnasium logs the worker's exception
    def test_in_worker_processes(self):
        env = PotentialShaping(AsyncVectorEnv([Reshaping], context="spawn"), level, GAMMA)
        env.reset(seed=0)
        with pytest.raises(UpslopeError, match=r"another shape than its observation space says .*could not broadcast"):
            env.step(np.zeros(1, int))
        env.close()

    def test_other_value_errors_are_unchanged(self):
        def failing():
            raise ValueError("an error of the simulator")

        with pytest.raises(ValueError, match="an error of the simulator"):
            call_workers(failing)

    def test_a_broken_pipe_is_a_dead_worker(self):
        def failing():
            raise BrokenPipeError

        with pytest.raises(DeadWorkerError, match="BrokenPipeError"):
            call_workers(failing)


class TestPartsOfObservations:
    def potential(self, obs):
        return obs["place"][0]

    def test_valid_parts_are_shaped(self):
        env = Single(Parts(*EPISODES), self.potential, GAMMA)
        env.reset(seed=0)
        assert env.step(0)[4]["shaping_reward"] == pytest.approx(0.9 * 5 - 2)

    @pytest.mark.parametrize(
        ("changed", "words"),
        [
            ({"place": np.zeros(3, np.float32)}, r"observation\['place'\] of shape \(3,\), .* says \(2,\)"),
            ({"place": np.zeros(1, np.float32)}, r"observation\['place'\] of shape \(1,\)"),
            ({"elsewhere": np.zeros(2, np.float32)}, "without the part 'place'"),
            (None, "without the part 'place'"),
        ],
    )
    def test_a_part_that_changes(self, changed, words):
        env = Single(Changing(changed), self.potential, GAMMA)
        env.reset(seed=0)
        with pytest.raises(UpslopeError, match=words):
            env.step(0)

    def test_a_part_that_changes_in_a_vector(self):
        env = PotentialShaping(SyncVectorEnv([lambda: Changing({"place": np.zeros(3)})]), self.potential, GAMMA)
        env.reset(seed=0)
        with pytest.raises(UpslopeError, match="another shape than its observation space says"):
            env.step(np.zeros(1, int))
