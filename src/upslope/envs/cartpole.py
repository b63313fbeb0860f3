"""CartPole with a pole of any length (Sec. 5.1), with discrete or continuous actions, in JAX.

The dynamics are Gymnasium's (Euler, 0.02 s). The length determines the pole's mass and centre, and so the dynamics.
"""

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from upslope.envs.cartpole_physics import FIFTEEN_DEGREES, PoleGeometry, euler_equations
from upslope.types import Key, Scalar


class CartPoleParams(PoleGeometry, eqx.Module):
    """The free parameters of one CartPole; the others are derived from them.

    Attributes:
        length: the full length of the pole, in metres. Gymnasium's default pole is 1.0 by this measure.
        gravity: m/s².
        cart_mass: kg.
        pole_density: kg per metre of pole; the default gives Gymnasium's 0.1 kg at length 1.0.
        force: newtons of a full push.
        time_step: seconds of one step.
        angle_limit: radians from upright beyond which the pole has fallen; the paper's 15 degrees.
        track_limit: metres from the centre beyond which the cart has left the track.
        max_steps_in_episode: number of steps after which an episode is truncated.
    """

    length: Float[Array, ""] | float = 1.0
    gravity: Float[Array, ""] | float = 9.8
    cart_mass: Float[Array, ""] | float = 1.0
    pole_density: Float[Array, ""] | float = 0.1
    force: Float[Array, ""] | float = 10.0
    time_step: Float[Array, ""] | float = 0.02
    angle_limit: Float[Array, ""] | float = FIFTEEN_DEGREES
    track_limit: Float[Array, ""] | float = 2.4
    max_steps_in_episode: int = eqx.field(static=True, default=200)


class CartPoleState(eqx.Module):
    """Position (m), velocity (m/s), angle (rad), angular velocity (rad/s), and steps taken in this episode."""

    physics: Float[Array, "4"]
    time: Int[Array, ""]


@dataclass(frozen=True)
class CartPole:
    """The environment, stateless, with the signature of gymnax ≥ 1.0.

    Discrete actions push left (0) or right (1) with the full force. A continuous action is one number in [−1, 1]:
    its sign is the direction, its absolute value the fraction of the full force.
    """

    continuous: bool = False

    #: Factors that bring each coordinate of an observation to the order of one.
    observation_scale = (1 / 2.4, 1 / 2.0, 1 / 0.2, 1 / 2.0)

    @property
    def actions(self) -> int:
        """The number of discrete actions, or of coordinates of a continuous one."""
        return 1 if self.continuous else 2

    def reset(self, key: Key, params: CartPoleParams) -> tuple[Float[Array, "4"], CartPoleState]:
        """Every coordinate is drawn from U[−0.05, 0.05]."""
        del params
        physics = jax.random.uniform(key, (4,), minval=-0.05, maxval=0.05)
        return physics, CartPoleState(physics, jnp.zeros((), jnp.int32))

    def step(
        self, key: Key, state: CartPoleState, action: Any, params: CartPoleParams
    ) -> tuple[Float[Array, "4"], CartPoleState, Scalar, Bool[Array, ""], Bool[Array, ""], dict[str, Array]]:
        """One step, with automatic reset.

        Returns:
            Observation to act on, state, reward (1 for every step), terminated, truncated, and
            ``info["final_observation"]``: the true successor; after an end the observation is the next episode's.
        """
        physics = euler_step(state.physics, self.push(action, params), params)
        time = state.time + 1
        position, _, angle, _ = physics
        terminated = (jnp.abs(position) > params.track_limit) | (jnp.abs(angle) > params.angle_limit)
        truncated = (time >= params.max_steps_in_episode) & ~terminated
        fresh_obs, fresh = self.reset(key, params)
        done = terminated | truncated
        following = jax.tree.map(lambda new, old: jnp.where(done, new, old), fresh, CartPoleState(physics, time))
        obs = jnp.where(done, fresh_obs, physics)
        return obs, following, jnp.ones(()), terminated, truncated, {"final_observation": physics}

    def push(self, action: Any, params: CartPoleParams) -> Scalar:
        """The force of an action, in newtons."""
        if self.continuous:
            return params.force * jnp.clip(jnp.reshape(action, ()), -1.0, 1.0)
        return params.force * (2.0 * jnp.asarray(action, jnp.float32) - 1.0)


def euler_step(physics: Float[Array, "4"], force: Scalar, params: CartPoleParams) -> Float[Array, "4"]:
    """Gymnasium's explicit Euler step of the cart and the pole, with every mass derived from the length."""
    angle = physics[2]
    return jnp.stack(euler_equations(tuple(physics), force, jnp.cos(angle), jnp.sin(angle), params))
