"""Two-link pendulums to swing up: gymnax's Acrobot with varied lengths and masses."""

import jax

from upslope.families.extras import gymnax
from upslope.tasks.gymnax_tasks import gymnax_tasks
from upslope.tasks.jax_tasks import JaxTasks


def acrobots(
    length: tuple[float, float] = (0.5, 1.5), mass: tuple[float, float] = (0.5, 1.5), gamma: float = 0.99
) -> JaxTasks:
    """Reward −1 per step until the tip is high enough; 500 steps are truncation. Both links are drawn."""
    env, params = gymnax().make("Acrobot-v1")

    def sample(key: jax.Array) -> object:
        first, second, heavy, heavier = jax.random.split(key, 4)
        length_1 = jax.random.uniform(first, minval=length[0], maxval=length[1])
        length_2 = jax.random.uniform(second, minval=length[0], maxval=length[1])
        return params.replace(
            link_length_1=length_1,
            link_length_2=length_2,
            link_com_pos_1=length_1 / 2,
            link_com_pos_2=length_2 / 2,
            link_mass_1=jax.random.uniform(heavy, minval=mass[0], maxval=mass[1]),
            link_mass_2=jax.random.uniform(heavier, minval=mass[0], maxval=mass[1]),
        )

    return gymnax_tasks(env, sample, gamma)
