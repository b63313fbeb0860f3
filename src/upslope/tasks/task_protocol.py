"""The older protocol of task distributions, in which an environment draws and sets its own tasks."""

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np

from upslope.errors import UpslopeError


def task_functions(
    make_env: Callable[[], Any],
) -> tuple[Callable[[np.random.Generator], Any], Callable[[Any], gym.Env], Callable[[gym.Env, Any], None]]:
    """A sampler of tasks, a factory, and what gives an environment a new task.

    The environments have ``sample_tasks(n)`` and ``set_task(task)``.

    ``reset_task`` works instead of ``set_task``.

    Raises:
        UpslopeError: the environment lacks these methods, or draws different tasks for the same seed.
    """
    sampler = make_env()
    base = sampler.unwrapped
    setter = next((name for name in ("set_task", "reset_task") if hasattr(base, name)), None)
    if setter is None or not hasattr(base, "sample_tasks"):
        raise UpslopeError(
            f"{type(base).__name__} has no sample_tasks and set_task: use GymnasiumTasks(sample, make_env, gamma)."
        )

    def sample(rng: np.random.Generator) -> Any:
        # Older environments draw with NumPy's global generator, so its state is restored.
        seed, before = int(rng.integers(2**31)), np.random.get_state()  # noqa: NPY002
        sampler.reset(seed=seed)
        np.random.seed(seed)  # noqa: NPY002
        try:
            return base.sample_tasks(1)[0]
        finally:
            np.random.set_state(before)  # noqa: NPY002

    def make(task: Any) -> gym.Env:
        env = make_env()
        set_task(env, task)
        return env

    def set_task(env: gym.Env, task: Any) -> None:
        getattr(env.unwrapped, setter)(task)

    pair = [repr(sample(np.random.default_rng(0))) for _ in range(2)]
    if pair[0] != pair[1]:
        raise UpslopeError(
            f"sample_tasks gave {pair[0]} and then {pair[1]} for the same seed: draw tasks with the environment's "
            "np_random or with numpy.random."
        )
    return sample, make, set_task
