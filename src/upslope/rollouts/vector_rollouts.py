"""Rollouts with Gymnasium's vector environments, which are made once and reused: in this process or in others."""

import time
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv

from upslope.rollouts.rollouts import AbstractRollouts, Act, Trajectories
from upslope.rollouts.task_slot import EnvironmentFactory, TaskSlot
from upslope.rollouts.workers import call_or_end, call_workers, close_or_end

Slots = list[Callable[[], gym.Env]]


def in_process(factory: EnvironmentFactory, observations: gym.Space, actions: gym.Space) -> AbstractRollouts:
    """Rollouts in this process, one environment after the other."""
    return VectorRollouts(_sync, factory, observations, actions)


def process_for_each(factory: EnvironmentFactory, observations: gym.Space, actions: gym.Space) -> AbstractRollouts:
    """Rollouts with one process for each environment; the policy acts in this one."""
    return VectorRollouts(_async, factory, observations, actions)


def _sync(slots: Slots) -> gym.vector.VectorEnv:
    return SyncVectorEnv(slots, autoreset_mode=AutoresetMode.SAME_STEP)


def _async(slots: Slots) -> gym.vector.VectorEnv:
    # Spawned, not forked: JAX runs threads, and a fork could inherit their locks.
    return AsyncVectorEnv(slots, autoreset_mode=AutoresetMode.SAME_STEP, context="spawn")


class VectorRollouts(AbstractRollouts):
    """Rollouts with vector environments: one for each group, and one per size for episodes that are abandoned.

    Args:
        make_vector: makes a vector environment from factories of its environments.
        factory: makes the environments of tasks.
        observations: the space that all environments share after `task_slot.fit_spaces`.
        actions: likewise.
    """

    def __init__(
        self,
        make_vector: Callable[[Slots], gym.vector.VectorEnv],
        factory: EnvironmentFactory,
        observations: gym.Space,
        actions: gym.Space,
    ):
        self._make_vector = make_vector
        self._slot = lambda: TaskSlot(factory, observations, actions)
        self._action_shape = actions.shape or ()
        self._action_dtype = np.float32 if np.issubdtype(actions.dtype, np.floating) else np.int32
        self._groups: dict[int, _Episodes] = {}
        self._scratch: dict[int, gym.vector.VectorEnv] = {}
        self._started = 0
        self._watch = _Stopwatch()

    @property
    def seconds(self) -> float:
        return self._watch.seconds

    def rollout(self, tasks: Sequence[Any], seed: int, act: Act, steps: int) -> Trajectories:
        return self._play(self._new_episodes(tasks, seed), act, steps)

    def returns(self, tasks: Sequence[Any], seed: int, act: Act, steps: int) -> np.ndarray:
        episodes = self._new_episodes(tasks, seed)
        alive, total = np.ones(len(tasks), bool), np.zeros(len(tasks), np.float32)
        for step in range(steps):
            rewards, terminated, truncated, _ = episodes.step(act(step, episodes.obs))
            total += alive * rewards
            alive &= ~(terminated | truncated)
            if not alive.any():
                break
        return total

    def start(self, tasks: Sequence[Any], seed: int) -> int:
        env = self._make(len(tasks))
        try:
            episodes = _Episodes(env, tasks, seed, self._watch)
        except BaseException:
            close_or_end(env, env.close)
            raise
        number = self._started
        self._started += 1
        self._groups[number] = episodes
        return number

    def knows(self, number: int, count: int) -> bool:
        return number in self._groups and self._groups[number].env.num_envs == count

    def collect(self, number: int, act: Act, steps: int) -> Trajectories:
        return self._play(self._groups[number], act, steps)

    def close(self) -> None:
        for env in (*(group.env for group in self._groups.values()), *self._scratch.values()):
            close_or_end(env, env.close)
        self._groups, self._scratch = {}, {}

    def _make(self, count: int) -> gym.vector.VectorEnv:
        return self._watch.time(call_workers, self._make_vector, [self._slot] * count)

    def _new_episodes(self, tasks: Sequence[Any], seed: int) -> "_Episodes":
        count = len(tasks)
        if count not in self._scratch:
            self._scratch[count] = self._make(count)
        return _Episodes(self._scratch[count], tasks, seed, self._watch)

    def _play(self, episodes: "_Episodes", act: Act, steps: int) -> Trajectories:
        # Steps come first here, so that each writes whole rows.
        obs = np.empty((steps, *episodes.obs.shape), np.float32)
        next_obs = np.empty_like(obs)
        action = np.empty((*obs.shape[:2], *self._action_shape), self._action_dtype)
        reward, terminated = np.empty(obs.shape[:2], np.float32), np.empty(obs.shape[:2], bool)
        for step in range(steps):
            obs[step] = shown = episodes.obs
            action[step] = chosen = act(step, shown)
            reward[step], terminated[step], _, next_obs[step] = episodes.step(chosen)
        return Trajectories(*(array.swapaxes(0, 1) for array in (obs, action, reward, terminated, next_obs)))


class _Episodes:
    """A vector environment in the middle of its episodes; new ones start at once.

    Attributes:
        env: the vector environment.
        obs: its last observations ``[n, *obs]``.
    """

    def __init__(self, env: Any, tasks: Sequence[Any], seed: int, watch: "_Stopwatch"):
        self.env = env
        self._watch = watch
        seeds = [int(word) for word in np.random.SeedSequence(seed).generate_state(len(tasks))]

        def reset() -> np.ndarray:
            env.set_attr("task", list(tasks))
            return env.reset(seed=seeds)[0]

        self.obs: np.ndarray = watch.time(call_or_end, env, reset)

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Takes one step in each: rewards, terminated, truncated ``[n]``, and true successors ``[n, *obs]``."""
        shown, rewards, terminated, truncated, infos = self._watch.time(call_or_end, self.env, self.env.step, actions)
        successors = shown
        if "final_obs" in infos:
            successors = shown.copy()
            for i in np.flatnonzero(infos["_final_obs"]):
                successors[i] = infos["final_obs"][i]
        self.obs = shown
        return rewards, terminated, truncated, successors


class _Stopwatch:
    """Adds up the seconds of the calls that it makes."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def time(self, function: Callable[..., Any], *inputs: Any) -> Any:
        began = time.perf_counter()
        try:
            return function(*inputs)
        finally:
            self.seconds += time.perf_counter() - began
