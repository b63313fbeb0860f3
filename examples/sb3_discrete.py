"""Stable-Baselines3's DQN or PPO on a pole that the prior never saw, with and without shaping.

``pip install 'upslope[sb3]'``, then ``python examples/sb3_discrete.py [--algorithm PPO] [--quick]``.
"""

from dataclasses import dataclass
from typing import Literal

import gymnasium as gym
import stable_baselines3 as sb3
import tyro
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor

import upslope


@dataclass(frozen=True)
class Options:
    """What to run."""

    algorithm: Literal["DQN", "PPO"] = "DQN"
    length: float = 3.0
    """Full length of the pole, in metres."""
    steps: int = 3000
    quick: bool = False
    """A short run, to check that everything works."""


def main(options: Options) -> None:
    """Trains twice, and prints raw greedy returns; the maximum is 200."""
    prior = upslope.load_prior("cartpole")
    settings = {
        "DQN": {
            "learning_rate": 1e-3, "learning_starts": 100, "train_freq": 1, "tau": 0.01, "target_update_interval": 1,
            "batch_size": 64, "policy_kwargs": {"net_arch": [32, 32]},
        },
        "PPO": {"n_steps": 256, "policy_kwargs": {"net_arch": [32, 32]}},
    }  # fmt: skip
    for shaped in (False, True):
        # The order matters: monitor inside (raw returns), shaping outside.
        env: gym.Env = Monitor(gym.make("upslope/CartPole-v0", length=options.length))
        if shaped:
            env = upslope.shape(env, prior, gamma=prior.gamma)
        learner = getattr(sb3, options.algorithm)
        model = learner("MlpPolicy", env, gamma=prior.gamma, device="cpu", seed=0, **settings[options.algorithm])
        model.learn(300 if options.quick else options.steps)
        bare = gym.make("upslope/CartPole-v0", length=options.length)  # never evaluate on shaped rewards
        mean, _ = evaluate_policy(model, bare, n_eval_episodes=5, warn=False)
        print(f"{options.algorithm}, {'shaped' if shaped else 'unshaped'}: raw return {mean:.1f}")


if __name__ == "__main__":
    main(tyro.cli(Options))
