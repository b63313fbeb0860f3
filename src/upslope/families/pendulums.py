"""Pendulums to swing up and hold: gymnax's Pendulum with varied gravity, mass and length."""

import jax

from upslope.envs.joint_grid import JointGrid
from upslope.families.extras import gymnax
from upslope.tasks.gymnax_tasks import gymnax_tasks
from upslope.tasks.jax_tasks import JaxTasks


def pendulums(
    gravity: tuple[float, float] = (5.0, 15.0),
    mass: tuple[float, float] = (0.5, 1.5),
    length: tuple[float, float] = (0.5, 1.5),
    gamma: float = 0.98,
    bins: int | None = 5,
) -> JaxTasks:
    """Minus the squared angle, speed and torque in each of 200 steps; ``bins`` torques, or a continuous one if None."""
    env, params = gymnax().make("Pendulum-v1")

    def sample(key: jax.Array) -> object:
        keys = jax.random.split(key, 3)
        drawn = {
            name: jax.random.uniform(k, minval=low, maxval=high)
            for name, k, (low, high) in zip(("g", "m", "l"), keys, (gravity, mass, length), strict=True)
        }
        return params.replace(**drawn)

    return gymnax_tasks(env if bins is None else JointGrid(env, bins), sample, gamma)
