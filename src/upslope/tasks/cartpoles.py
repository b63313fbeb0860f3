"""The family of CartPoles with different pole lengths (Sec. 5.1)."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from upslope.envs.cartpole import CartPole, CartPoleParams
from upslope.errors import UpslopeError
from upslope.tasks.actions import ContinuousActions, DiscreteActions
from upslope.tasks.jax_tasks import JaxTasks
from upslope.types import Key


class PoleLengths(eqx.Module):
    """Draws CartPoles with pole lengths from U[low, high]; these are full lengths in metres."""

    low: float = eqx.field(static=True)
    high: float = eqx.field(static=True)
    angle_limit: float = eqx.field(static=True)
    track_limit: float = eqx.field(static=True)
    max_steps: int = eqx.field(static=True)

    def __call__(self, key: Key) -> CartPoleParams:
        return self.with_length(jax.random.uniform(key, minval=self.low, maxval=self.high))

    def with_length(self, length: Float[Array, ""] | float) -> CartPoleParams:
        """The task of the family whose pole has this full length in metres."""
        task = CartPoleParams(
            length,
            angle_limit=self.angle_limit,
            track_limit=self.track_limit,
            max_steps_in_episode=self.max_steps,
        )
        return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), task)


def cartpoles(
    length: tuple[float, float] = (0.25, 5.0),
    *,
    continuous: bool = False,
    half_length: bool = False,
    gamma: float = 0.98,
    angle_limit_degrees: float = 15.0,
    track_limit: float = 2.4,
    max_steps: int = 200,
) -> JaxTasks:
    """The paper's p(T) over CartPoles.

    Args:
        length: bounds of the uniform distribution of pole lengths, in metres.
        continuous: whether an action is a force in [−1, 1] (times 10 N) instead of one of two pushes.
        half_length: whether the bounds are for half the pole, like Gymnasium's ``length``, instead of the whole pole.
        gamma: γ of every task and of every potential learned here.
        angle_limit_degrees: the angle beyond which the pole has fallen.
        track_limit: the position beyond which the cart has left the track, in metres.
        max_steps: number of steps after which an episode is truncated.

    Raises:
        UpslopeError: the range is reversed, not positive or not finite, γ is outside (0, 1], or a limit or the number
            of steps is not positive.
    """
    low, high = length
    if not (math.isfinite(low) and math.isfinite(high) and 0 < low <= high):
        raise UpslopeError(
            f"The pole lengths {low} to {high} are no range of lengths: give two positive numbers, the smaller first."
        )
    if not 0 < gamma <= 1:
        raise UpslopeError(f"gamma is {gamma}, but a discount lies in (0, 1]: give one such as 0.98.")
    if not (angle_limit_degrees > 0 and track_limit > 0 and max_steps >= 1):
        raise UpslopeError("The angle limit, the track limit and the number of steps must all be positive.")
    env = CartPole(continuous=continuous)
    scale = 2.0 if half_length else 1.0
    return JaxTasks(
        name="cartpole",
        env=env,
        sample_params=PoleLengths(scale * low, scale * high, math.radians(angle_limit_degrees), track_limit, max_steps),
        gamma=gamma,
        observation_shape=(4,),
        observation_scale=env.observation_scale,
        actions=ContinuousActions(1) if continuous else DiscreteActions(2),
        max_steps=max_steps,
        recipe="poles",
    )
