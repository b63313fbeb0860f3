"""SBX (Stable-Baselines in JAX) on a pole that the prior never saw, with and without shaping.

``pip install sbx-rl``, then ``python examples/sbx_dqn.py [--quick]``.
"""

from dataclasses import dataclass

import gymnasium as gym
import sbx
import tyro
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor

import upslope


@dataclass(frozen=True)
class Options:
    """What to run."""

    length: float = 3.0
    """Full length of the pole, in metres."""
    steps: int = 3000
    quick: bool = False
    """A short run, to check that everything works."""


def main(options: Options) -> None:
    """Trains twice, and prints raw greedy returns; the maximum is 200."""
    prior = upslope.load_prior("cartpole")
    for shaped in (False, True):
        env: gym.Env = Monitor(gym.make("upslope/CartPole-v0", length=options.length))
        if shaped:
            env = upslope.shape(env, prior, gamma=prior.gamma)
        model = sbx.DQN(
            "MlpPolicy", env, gamma=prior.gamma, learning_rate=1e-3, learning_starts=100, train_freq=1, tau=0.01,
            target_update_interval=1, batch_size=64, policy_kwargs={"net_arch": [32, 32]}, seed=0,
        )  # fmt: skip
        model.learn(200 if options.quick else options.steps)
        bare = gym.make("upslope/CartPole-v0", length=options.length)
        mean, _ = evaluate_policy(model, bare, n_eval_episodes=5, warn=False)
        print(f"SBX DQN, {'shaped' if shaped else 'unshaped'}: raw return {mean:.1f}")


if __name__ == "__main__":
    main(tyro.cli(Options))
