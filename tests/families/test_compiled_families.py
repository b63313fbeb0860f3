"""Families of gymnax's environments: what is drawn changes the physics, and nothing else does."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from upslope.families.acrobots import acrobots
from upslope.families.mountain_cars import continuous_mountain_cars, mountain_cars
from upslope.families.pendulums import pendulums

FAMILIES = {
    "mountain cars": (mountain_cars, 3, 200, ("gravity", "force")),
    "continuous mountain cars": (continuous_mountain_cars, 3, 999, ("gravity", "power")),
    "acrobots": (acrobots, 3, 500, ("link_length_1", "link_length_2", "link_mass_1", "link_mass_2")),
    "pendulums": (pendulums, 5, 200, ("g", "m", "l")),
}


@pytest.mark.parametrize(("build", "actions", "steps", "varied"), FAMILIES.values(), ids=FAMILIES)
def test_only_these_parameters_vary(build, actions, steps, varied):
    family = build()
    assert (family.actions.count, family.max_steps) == (actions, steps)
    tasks = family.sample_many(jax.random.key(0), 30)
    for name, values in vars(tasks).items():
        if name.startswith("link_com_pos"):
            np.testing.assert_allclose(values, getattr(tasks, name.replace("com_pos", "length")) / 2)
        else:
            assert (np.ptp(np.asarray(values), axis=0).max() > 0) == (name in varied), name


@pytest.mark.parametrize("build", [mountain_cars, pendulums])
def test_they_change_what_happens(build):
    family = build()
    tasks = family.sample_many(jax.random.key(0), 2)
    state = jax.vmap(lambda task: family.env.reset(jax.random.key(1), task)[1])(tasks)
    following = jax.vmap(lambda state, task: family.env.step(jax.random.key(2), state, jnp.asarray(2), task)[0])
    one, other = following(state, tasks)
    assert np.abs(one - other).max() > 1e-5


def test_a_mountain_car_pays_one_per_step_until_it_is_truncated():
    family = mountain_cars()
    tasks = family.sample_many(jax.random.key(0), 2)
    stay = lambda key, obs: jnp.ones(len(obs), jnp.int32)  # noqa: E731
    np.testing.assert_array_equal(family.returns(jax.random.key(1), tasks, stay), [-200, -200])
    seen = family.rollout(jax.random.key(1), tasks, stay, 200)
    assert (np.asarray(seen.discount) == np.float32(family.gamma)).all(), "a time limit is no termination"
