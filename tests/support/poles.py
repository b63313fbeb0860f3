"""CartPoles compared with Gymnasium's: the same task in both, and one trajectory of each."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.envs.classic_control.cartpole import CartPoleEnv

from upslope.envs.cartpole import CartPole, CartPoleParams, CartPoleState


def gymnasium_twin(length: float, angle_limit_degrees: float = 15.0) -> CartPoleEnv:
    """Gymnasium's CartPole with a pole of this full length, and everything that follows from the length set by hand."""
    env = CartPoleEnv()
    env.length = length / 2
    env.masspole = 0.1 * length
    env.total_mass = env.masscart + env.masspole
    env.polemass_length = env.masspole * env.length
    env.theta_threshold_radians = math.radians(angle_limit_degrees)
    return env


def gymnasium_trajectory(env: CartPoleEnv, start: np.ndarray, actions: np.ndarray) -> np.ndarray:
    """States in float64 after each action ``[steps, 4]``, up to and including the one that ends the episode."""
    env.reset(seed=0)
    env.state = np.asarray(start, np.float64)
    states = []
    for action in actions:
        _, reward, terminated, _, _ = env.step(int(action))
        assert reward == 1.0
        states.append(env.state)
        if terminated:
            break
    return np.array(states)


def poles(lengths, **settings) -> CartPoleParams:
    """Stacked parameters ``[n]``, in JAX's current float type."""
    return jax.vmap(lambda length: jax.tree.map(jnp.asarray, CartPoleParams(length, **settings)))(jnp.asarray(lengths))


@jax.jit
def our_trajectories(params: CartPoleParams, starts, actions):
    """True successors ``[n, steps, 4]``, terminated and truncated ``[n, steps]``; resets still happen."""
    env = CartPole()

    def one(params, start, actions):
        def step(state, action):
            _, state, reward, terminated, truncated, info = env.step(jax.random.key(0), state, action, params)
            return state, (info["final_observation"], reward, terminated, truncated)

        return jax.lax.scan(step, CartPoleState(start, jnp.zeros((), jnp.int32)), actions)[1]

    return jax.vmap(one)(params, starts, actions)
