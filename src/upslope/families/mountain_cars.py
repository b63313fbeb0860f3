"""Cars in a valley: gymnax's MountainCar with varied gravity and force."""

import jax

from upslope.envs.joint_grid import JointGrid
from upslope.families.extras import gymnax
from upslope.tasks.gymnax_tasks import gymnax_tasks
from upslope.tasks.jax_tasks import JaxTasks


def mountain_cars(
    gravity: tuple[float, float] = (0.002, 0.003), force: tuple[float, float] = (0.0008, 0.0015), gamma: float = 0.99
) -> JaxTasks:
    """Reward −1 per step until the hill is reached; 200 steps are truncation."""
    env, params = gymnax().make("MountainCar-v0")

    def sample(key: jax.Array) -> object:
        gravity_key, force_key = jax.random.split(key)
        return params.replace(
            gravity=jax.random.uniform(gravity_key, minval=gravity[0], maxval=gravity[1]),
            force=jax.random.uniform(force_key, minval=force[0], maxval=force[1]),
        )

    return gymnax_tasks(env, sample, gamma)


def continuous_mountain_cars(
    gravity: tuple[float, float] = (0.002, 0.003),
    power: tuple[float, float] = (0.0012, 0.002),
    gamma: float = 0.99,
    bins: int | None = 3,
) -> JaxTasks:
    """Reward 100 on the hill, less the force that was used; ``bins`` forces, or a continuous one if None."""
    env, params = gymnax().make("MountainCarContinuous-v0")

    def sample(key: jax.Array) -> object:
        gravity_key, power_key = jax.random.split(key)
        return params.replace(
            gravity=jax.random.uniform(gravity_key, minval=gravity[0], maxval=gravity[1]),
            power=jax.random.uniform(power_key, minval=power[0], maxval=power[1]),
        )

    return gymnax_tasks(env if bins is None else JointGrid(env, bins), sample, gamma)
