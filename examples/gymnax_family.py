"""A family from a third-party JAX environment: gymnax's Acrobot with links of any length.

Meta-trains a prior over link lengths, and compares shaped and unshaped DQN on unseen links; everything is
compiled. ``pip install --no-deps gymnax==1.0.1`` (it pins an older Gymnasium) and ``pip install flax seaborn``, then
``python examples/gymnax_family.py [--quick]``.
"""

from dataclasses import dataclass

import gymnax
import jax
import numpy as np
import tyro

import upslope


@dataclass(frozen=True)
class Options:
    """What to run."""

    iterations: int = 300
    """Iterations of meta-training."""
    updates: int = 1500
    """Updates of each DQN."""
    links: int = 5
    """Number of unseen tasks."""
    seed: int = 0
    quick: bool = False
    """A short run, to check that everything works."""


def main(options: Options) -> None:
    """Meta-trains, and prints median raw returns over unseen links: minus the number of steps, −500 at worst."""
    iterations, updates, links = (2, 20, 1) if options.quick else (options.iterations, options.updates, options.links)
    env, params = gymnax.make("Acrobot-v1")

    def sample(key: jax.Array) -> object:
        """A task: the parameters, including those that depend on the length of the upper link."""
        length = jax.random.uniform(key, minval=0.5, maxval=1.5)
        return params.replace(link_length_1=length, link_com_pos_1=length / 2, link_mass_1=length)

    family = upslope.gymnax_tasks(env, sample, gamma=0.97)
    config = upslope.MetaTrainingConfig(iterations=iterations, snapshot_every=max(1, iterations // 10))
    prior = upslope.meta_train(family, seed=options.seed, config=config)
    dqn = upslope.DQNConfig(warmup_steps=64) if options.quick else upslope.DQNConfig(decay_updates=updates)
    for shaped in (False, True):
        returns = []
        for index in range(links):
            task = family.sample(jax.random.key(10_000 + index))
            result = upslope.train(
                family, task, prior if shaped else None, updates=updates, every=updates // 10, seed=index, config=dqn
            )
            returns.append(result.returns)
        median = np.median(returns, axis=0)
        arm = "shaped" if shaped else "unshaped"
        print(f"{arm}: raw return {median.mean():.0f} on average, {median[-1]:.0f} at the end")


if __name__ == "__main__":
    main(tyro.cli(Options))
