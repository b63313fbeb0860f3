"""The family of CartPoles with varied pole length (Sec. 5.1)."""

import math
from dataclasses import dataclass

import jax

from upslope.envs.cartpole import CartPole, CartPoleParams
from upslope.errors import UpslopeError
from upslope.tasks.jax_tasks import JaxTasks
from upslope.types import Key


@dataclass(frozen=True)
class PoleLengths:
    """Draws CartPoles with a pole length from U[low, high], as full lengths in metres."""

    low: float
    high: float
    angle_limit: float
    track_limit: float
    max_steps: int

    def __call__(self, key: Key) -> CartPoleParams:
        length = jax.random.uniform(key, minval=self.low, maxval=self.high)
        return cartpole_task(
            length, angle_limit=self.angle_limit, track_limit=self.track_limit, max_steps=self.max_steps
        )


def cartpole_task(length, *, angle_limit: float, track_limit: float, max_steps: int) -> CartPoleParams:
    """One task of the family: a CartPole whose pole has this full length in metres."""
    task = CartPoleParams(length, angle_limit=angle_limit, track_limit=track_limit, max_steps_in_episode=max_steps)
    return jax.tree.map(lambda leaf: jax.numpy.asarray(leaf, "float32"), task)


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
        continuous: one force in [−1, 1] (times 10 N) instead of two pushes.
        half_length: the bounds are for half the pole, as Gymnasium's ``length`` is, instead of the whole pole.
        gamma: γ, of every task and of every potential learned here.
        angle_limit_degrees: the pole has fallen beyond this.
        track_limit: the cart has left the track beyond this, in metres.
        max_steps: truncation.

    Raises:
        UpslopeError: an empty, reversed, negative or non-finite range, or a γ outside (0, 1].
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
        actions=env.actions,
        continuous=continuous,
        max_steps=max_steps,
    )
