"""The environments that `gymnasium.make` knows once upslope is imported. Importing this needs no JAX."""

import gymnasium as gym

#: Steps after which an episode is truncated, unless `gymnasium.make` is told otherwise.
MAX_STEPS = 200

_ENTRY_POINT = "upslope.envs.gymnasium_cartpole:GymnasiumCartPole"


def register_environments() -> None:
    """Registers ``upslope/CartPole-v0`` and ``upslope/ContinuousCartPole-v0``; a second call does nothing."""
    for name, continuous in (("upslope/CartPole-v0", False), ("upslope/ContinuousCartPole-v0", True)):
        if name not in gym.registry:
            gym.register(name, entry_point=_ENTRY_POINT, max_episode_steps=MAX_STEPS, kwargs={"continuous": continuous})
