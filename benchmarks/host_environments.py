"""Gymnasium's vector environments, stepped on the host: at random, with a policy, with a step of Q-learning."""

from collections.abc import Callable
from typing import Any, NamedTuple

import gymnasium as gym
import jax
import numpy as np

from upslope.equations.maml import descend
from upslope.learners.dqn import dqn_loss
from upslope.networks.q_network import QNetwork
from upslope.types import Transition

STEP_SIZE = 1e-3

#: Each holds its map in Python's lists, 60 kB; 20,000 of them take a minute to make.
_FROZEN_LAKES = 1000


class Hosted(NamedTuple):
    """Environments, and how many steps of all of them make a repeat."""

    envs: Any
    steps: int


def on_host(width: int, steps: int, numpy_steps: int, asynchronous: int) -> dict[str, Hosted]:
    """By name: one after the other, in processes up to a width, and CartPole in numpy, whose steps are far cheaper."""
    found = {
        "CartPole, Gymnasium Sync": Hosted(gym.make_vec("CartPole-v1", width, "sync"), steps),
        "CartPole, Gymnasium in numpy": Hosted(gym.make_vec("CartPole-v1", width, "vector_entry_point"), numpy_steps),
    }
    if width <= _FROZEN_LAKES:
        lakes = gym.make_vec("FrozenLake-v1", width, "sync", map_name="8x8", is_slippery=False)
        found["grid, Gymnasium Sync (FrozenLake)"] = Hosted(lakes, steps)
    if width <= asynchronous:
        kwargs = {"vector_kwargs": {"context": "spawn"}}
        found["CartPole, Gymnasium Async"] = Hosted(gym.make_vec("CartPole-v1", width, "async", **kwargs), steps)
    return found


def hosted(envs: Any, steps: int, level: str) -> Callable[[], object]:
    """The same on the host; the network runs in one compiled call for all environments."""
    rng = np.random.default_rng(0)
    width, actions = envs.num_envs, int(envs.single_action_space.n)
    discrete = isinstance(envs.single_observation_space, gym.spaces.Discrete)
    inputs = int(envs.single_observation_space.n) if discrete else 4
    network = QNetwork(jax.random.key(1), inputs, actions)

    def flat(obs: np.ndarray) -> np.ndarray:
        return np.eye(inputs, dtype=np.float32)[obs] if discrete else obs

    @jax.jit
    def act(network: QNetwork, obs: jax.Array) -> jax.Array:
        return jax.vmap(network.best)(obs)

    @jax.jit
    def improve(network: QNetwork, seen: Transition) -> QNetwork:
        return descend(network, jax.grad(dqn_loss)(network, network, seen, 3.0), STEP_SIZE)

    obs = envs.reset(seed=0)[0]

    def play() -> None:
        nonlocal obs, network
        for _ in range(steps):
            now = flat(obs)
            action = rng.integers(actions, size=width) if level == "alone" else np.asarray(act(network, now))
            obs, reward, terminated, _, _ = envs.step(action)
            if level == "with training":
                discount = (0.98 * (1.0 - terminated)).astype(np.float32)
                network = improve(network, Transition(now, action, reward.astype(np.float32), discount, flat(obs)))
        jax.block_until_ready(network)

    return play
