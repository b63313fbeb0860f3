"""Stable-Baselines3's SAC, TD3 or DDPG on a continuous pole: its prior was meta-trained with discrete actions.

``pip install 'upslope[sb3]'``, then ``python examples/sb3_continuous.py [--algorithm TD3] [--quick]``.
"""

from dataclasses import dataclass
from typing import Literal

import gymnasium as gym
import stable_baselines3 as sb3
import tyro
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy

import upslope


@dataclass(frozen=True)
class Options:
    """What to run."""

    algorithm: Literal["SAC", "TD3", "DDPG"] = "SAC"
    length: float = 3.0
    """Full length of the pole, in metres."""
    steps: int = 3000
    quick: bool = False
    """A short run, to check that everything works."""


def main(options: Options) -> None:
    """Trains twice, and prints raw greedy returns; the maximum is 200."""
    prior = upslope.load_prior("cartpole")
    name, pole = "upslope/ContinuousCartPole-v0", {"length": options.length}
    for shaped in (False, True):
        envs = make_vec_env(name, env_kwargs=pole)  # each with its own monitor, which reports raw returns
        if shaped:
            envs = upslope.shape(envs, prior, gamma=prior.gamma)
        learner = getattr(sb3, options.algorithm)
        small = {"net_arch": [64, 64]}
        model = learner(
            "MlpPolicy", envs, gamma=prior.gamma, learning_starts=100, policy_kwargs=small, device="cpu", seed=0
        )
        model.learn(200 if options.quick else options.steps)
        mean, _ = evaluate_policy(model, gym.make(name, **pole), n_eval_episodes=5, warn=False)
        print(f"{options.algorithm}, {'shaped' if shaped else 'unshaped'}: raw return {mean:.1f}")


if __name__ == "__main__":
    main(tyro.cli(Options))
