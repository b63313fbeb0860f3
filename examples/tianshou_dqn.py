"""Tianshou's DQN on a pole that the prior never saw, with and without shaping.

Tianshou pins pandas below 3, so it needs a separate environment: ``make tianshou`` creates it and runs the quick
form.
"""

from dataclasses import dataclass

import gymnasium as gym
import numpy as np
import torch
import tyro
from tianshou.algorithm import DQN
from tianshou.algorithm.modelfree.dqn import DiscreteQLearningPolicy
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Collector, CollectStats, VectorReplayBuffer
from tianshou.env import DummyVectorEnv
from tianshou.trainer import OffPolicyTrainerParams
from tianshou.utils.net.common import Net

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
    for shaped in (False, True):
        print(f"{'shaped' if shaped else 'unshaped'}: raw return {train(options, shaped):.1f}")


def train(options: Options, shaped: bool) -> float:
    """One run: the mean raw greedy return at its end."""
    prior = upslope.load_prior("cartpole")
    np.random.seed(0)  # noqa: NPY002 (Tianshou draws with NumPy's global generator)
    torch.manual_seed(0)

    def pole() -> gym.Env:
        return gym.make("upslope/CartPole-v0", length=options.length)

    def for_learning() -> gym.Env:
        return upslope.shape(pole(), prior, gamma=prior.gamma) if shaped else pole()

    # Tianshou resets its environments one by one, so the single wrapper goes inside its vector.
    envs, raw = DummyVectorEnv([for_learning]), DummyVectorEnv([pole] * 5)
    envs.seed(0)
    raw.seed(0)
    policy = DiscreteQLearningPolicy(
        model=Net(state_shape=4, action_shape=2, hidden_sizes=[32, 32]),
        action_space=pole().action_space,
        eps_training=0.1,
    )
    algorithm = DQN(policy=policy, optim=AdamOptimizerFactory(lr=1e-3), gamma=prior.gamma, target_update_freq=100)
    collector = Collector[CollectStats](algorithm, envs, VectorReplayBuffer(10_000, 1), exploration_noise=True)
    collector.reset()
    collector.collect(n_step=100, random=True)
    test = Collector[CollectStats](algorithm, raw)  # never evaluate on shaped rewards
    steps = 200 if options.quick else options.steps
    algorithm.run_training(
        OffPolicyTrainerParams(
            training_collector=collector,
            max_epochs=1,
            epoch_num_steps=steps,
            collection_step_num_env_steps=10,
            batch_size=64,
            verbose=False,
            show_progress=False,
        )
    )
    test.reset()
    return float(test.collect(n_episode=5).returns.mean())


if __name__ == "__main__":
    main(tyro.cli(Options))
