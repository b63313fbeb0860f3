"""A corridor with a goal at one of its ends, and networks whose V and Q are known by hand."""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from upslope.networks.dueling import AbstractDueling
from upslope.networks.heads import DiscreteHead
from upslope.tasks import JaxTasks
from upslope.tasks.actions import DiscreteActions

PLACES, START, GAMMA, LIMIT = 21, 10, 0.9, 40


class Walker(eqx.Module):
    """Where one stands, and the number of steps so far."""

    place: Int[Array, ""]
    time: Int[Array, ""]


@dataclass(frozen=True)
class Corridor:
    """The first action goes down, the second up. Reward 1 at the goal, an end of the corridor, which the task names.

    Observations are the place, one-hot, and the side of the goal, 0 or 1.
    """

    def reset(self, key, params):
        del key
        return self.observe(START, params), Walker(jnp.asarray(START), jnp.asarray(0))

    def step(self, key, state, action, params):
        place = jnp.clip(state.place + 2 * action - 1, 0, PLACES - 1)
        terminated = place == params * (PLACES - 1)
        truncated = (state.time + 1 >= LIMIT) & ~terminated
        fresh_obs, fresh = self.reset(key, params)
        obs, done = self.observe(place, params), terminated | truncated
        following = jax.tree.map(lambda new, old: jnp.where(done, new, old), fresh, Walker(place, state.time + 1))
        info = {"final_observation": obs}
        return jnp.where(done, fresh_obs, obs), following, terminated * 1.0, terminated, truncated, info

    def observe(self, place, goal):
        return jnp.append(jax.nn.one_hot(place, PLACES), goal)


@dataclass(frozen=True)
class RandomGoals:
    """Draws the side of the goal."""

    def __call__(self, key) -> Int[Array, ""]:
        return jax.random.randint(key, (), 0, 2)


def corridors() -> JaxTasks:
    """The family of both goals."""
    return JaxTasks(
        name="corridor",
        env=Corridor(),
        sample_params=RandomGoals(),
        gamma=GAMMA,
        observation_shape=(PLACES + 1,),
        observation_scale=(1.0,) * (PLACES + 1),
        actions=DiscreteActions(2),
        max_steps=LIMIT,
        recipe="vectors",
    )


class Known(AbstractDueling):
    """A network of tables ``[goals, places, actions]``."""

    table: Float[Array, "goals places actions"]
    advantage_head: DiscreteHead

    def __init__(self, table):
        self.table = table
        self.advantage_head = DiscreteHead.fresh(jax.random.key(0), 1, 2)

    def heads(self, obs):
        q = self.table[obs[-1].astype(int), obs[:-1].argmax()]
        return q.max(), q


def optimal() -> Known:
    """Q* of both tasks: γ to the power of the steps that are left after the action."""
    places = jnp.arange(PLACES)

    def q_of(goal):
        following = jnp.clip(places[:, None] + jnp.array([-1, 1]), 0, PLACES - 1)
        return GAMMA ** jnp.abs(following - goal * (PLACES - 1))

    return Known(jnp.stack([q_of(0), q_of(1)]))


def constant(level: float) -> Known:
    """The same V everywhere, which is Q of going down."""
    return Known(jnp.tile(jnp.array([level, level - 1.0]), (2, PLACES, 1)))
