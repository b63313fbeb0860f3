"""The environments that `gymnasium.make` knows once upslope is imported. Importing this needs no JAX."""

import gymnasium as gym

#: Steps after which an episode is truncated, unless `gymnasium.make` is given another limit.
MAX_STEPS = 200
MAX_STEPS_ON_MAPS = 50

_CARTPOLE = "upslope.envs.gymnasium_cartpole:GymnasiumCartPole"
_GRID = "upslope.envs.gymnasium_grid:GymnasiumGrid"


def register_environments() -> None:
    """Registers ``upslope/CartPole-v0``, ``upslope/ContinuousCartPole-v0`` and ``upslope/Grid-v0``, once."""
    for name, entry_point, limit, settings in (
        ("upslope/CartPole-v0", _CARTPOLE, MAX_STEPS, {"continuous": False}),
        ("upslope/ContinuousCartPole-v0", _CARTPOLE, MAX_STEPS, {"continuous": True}),
        ("upslope/Grid-v0", _GRID, MAX_STEPS_ON_MAPS, {}),
    ):
        if name not in gym.registry:
            gym.register(name, entry_point=entry_point, max_episode_steps=limit, kwargs=settings)
