"""Vectors of host environments, made once and reused: the one place of a host family that changes."""

import time
from collections.abc import Callable, Sequence
from typing import Any, Literal

import gymnasium as gym
import numpy as np
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv

from upslope.rollouts.task_slot import TaskSlot
from upslope.rollouts.workers import alive, call_or_end, close_or_end

Mode = Literal["sync", "async"]


class HostEnvironments:
    """Vector environments by number; scratch ones, for what is given up at once, by their size.

    Attributes:
        seconds: spent inside environments, factories and pipes included.
    """

    def __init__(self, make_env: Callable[[Any], gym.Env], spaces: tuple[gym.Space, gym.Space], mode: Mode):
        """Takes the factory of the environments, their observation and action space, and where they run."""
        self._slot = lambda: TaskSlot(make_env, *spaces)
        self._mode = mode
        self._running: dict[int, gym.vector.VectorEnv] = {}
        self._scratch: dict[int, gym.vector.VectorEnv] = {}
        self._obs: dict[int, np.ndarray] = {}
        self._started = 0
        self.seconds = 0.0

    def start(self, tasks: Sequence[Any], seed: int) -> int:
        """Makes a vector environment that goes on from call to call, one sub-environment for each task.

        Returns:
            Its number.
        """
        number = self._started
        self._started += 1
        self._running[number] = self._made(len(tasks))
        self._obs[number] = self._reset(self._running[number], tasks, seed)
        return number

    def knows(self, number: int, count: int) -> bool:
        """Whether the vector environment of this number is running here, with so many sub-environments."""
        return number in self._running and self._running[number].num_envs == count

    def go_on(self, number: int) -> "Episodes":
        """The vector environment of this number, where it was left."""
        return Episodes(self, self._running[number], self._obs[number], number)

    def fresh(self, tasks: Sequence[Any], seed: int) -> "Episodes":
        """A scratch vector environment, newly reset."""
        count = len(tasks)
        if count not in self._scratch:
            self._scratch[count] = self._made(count)
        return Episodes(self, self._scratch[count], self._reset(self._scratch[count], tasks, seed), None)

    def left(self, number: int, obs: np.ndarray) -> None:
        """Remembers where a vector environment was left."""
        self._obs[number] = obs

    def close(self) -> None:
        """Closes all; they are made anew when needed."""
        for env in (*self._running.values(), *self._scratch.values()):
            close_or_end(env, env.close)
        self._running, self._scratch, self._obs = {}, {}, {}

    def on_the_clock(self, function: Callable[..., Any], *inputs: Any) -> Any:
        """Calls a function, its time counted."""
        began = time.perf_counter()
        try:
            return function(*inputs)
        finally:
            self.seconds += time.perf_counter() - began

    def _made(self, count: int) -> gym.vector.VectorEnv:
        slots = [self._slot] * count
        if self._mode == "sync":
            return SyncVectorEnv(slots, autoreset_mode=AutoresetMode.SAME_STEP)
        # Spawned, not forked: JAX runs threads, and a fork could inherit their locks.
        return self.on_the_clock(
            alive, lambda: AsyncVectorEnv(slots, autoreset_mode=AutoresetMode.SAME_STEP, context="spawn")
        )

    def _reset(self, env: Any, tasks: Sequence[Any], seed: int) -> np.ndarray:
        seeds = [int(word) for word in np.random.SeedSequence(seed).generate_state(len(tasks))]

        def reset() -> np.ndarray:
            env.set_attr("task", list(tasks))
            return env.reset(seed=seeds)[0]

        return self.on_the_clock(call_or_end, env, reset)


class Episodes:
    """A vector environment in the middle of its episodes."""

    def __init__(self, pool: HostEnvironments, env: gym.vector.VectorEnv, obs: np.ndarray, number: int | None):
        """Takes the pool, the vector environment, what it showed last, and its number if it is to go on later."""
        self.obs = obs
        self._pool, self._env, self._number = pool, env, number

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """One step of each: rewards, terminated, truncated ``[n]``, and true successors ``[n, *obs]``."""
        shown, rewards, terminated, truncated, infos = self._pool.on_the_clock(
            call_or_end, self._env, self._env.step, actions
        )
        successors = shown
        if "final_obs" in infos:
            successors = shown.copy()
            for i in np.flatnonzero(infos["_final_obs"]):
                successors[i] = infos["final_obs"][i]
        self.obs = shown
        if self._number is not None:
            self._pool.left(self._number, shown)
        return rewards, terminated, truncated, successors
