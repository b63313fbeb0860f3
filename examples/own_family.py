"""A family of your own from a stock Gymnasium environment: frozen lakes with maps drawn at random.

Meta-trains a prior over maps, checks the shaping, and compares tabular Q-learning with and without it on unseen
maps. ``python examples/own_family.py [--quick]``; it needs no torch, and you write no JAX.
"""

from dataclasses import dataclass

import gymnasium as gym
import numpy as np
import tyro
from gymnasium.envs.toy_text.frozen_lake import generate_random_map
from gymnasium.wrappers import FlattenObservation

import upslope

SIZE, GAMMA = 5, 0.95


@dataclass(frozen=True)
class Options:
    """What to run."""

    iterations: int = 300
    """Iterations of meta-training."""
    maps: int = 20
    """Number of unseen maps."""
    episodes: int = 300
    """Episodes of Q-learning on each map."""
    seed: int = 0
    quick: bool = False
    """A short run, to check that everything works."""


def sample(rng: np.random.Generator) -> list[str]:
    """A task: a map with a path to the goal."""
    return generate_random_map(size=SIZE, p=0.8, seed=int(rng.integers(2**31)))


def make_env(task: list[str]) -> gym.Env:
    """The environment of a task. Observations are the cell's number, one-hot."""
    return FlattenObservation(gym.make("FrozenLake-v1", desc=task, is_slippery=False, max_episode_steps=50))


def main(options: Options) -> None:
    """Meta-trains a prior, checks the shaping, and compares Q-learning with and without it."""
    iterations, maps, episodes = (4, 2, 5) if options.quick else (options.iterations, options.maps, options.episodes)
    lakes = upslope.GymnasiumTasks(sample, make_env, gamma=GAMMA)
    config = upslope.MetaTrainingConfig(iterations=iterations, epsilon=(0.3, 1.0))
    prior = upslope.meta_train(lakes, seed=options.seed, config=config)
    lakes.close()
    unseen = [sample(np.random.default_rng([options.seed, 1, index])) for index in range(maps)]
    print(upslope.check_shaping(upslope.shape(make_env(unseen[0]), prior, gamma=GAMMA), prior, GAMMA))
    for shaped in (False, True):
        solved = []
        for index, task in enumerate(unseen):
            env = make_env(task)
            if shaped:
                env = upslope.shape(env, prior, gamma=prior.gamma)
            solved.append(q_learning(env, episodes, seed=index))
        median = np.median(np.where(np.isinf(solved), episodes + 1, solved))
        words = f"{median:.0f} episodes" if median <= episodes else f"not within {episodes} episodes"
        share = f"{np.mean(np.isfinite(solved)):.0%} of the maps solved at all"
        print(f"{'shaped' if shaped else 'unshaped'}: median map solved after {words}; {share}")


def q_learning(env: gym.Env, episodes: int, seed: int) -> float:
    """The episode after which the greedy policy reaches the goal; infinity if none."""
    rng = np.random.default_rng(seed)
    q = np.zeros((SIZE * SIZE, 4))
    for episode in range(episodes):
        state, ended = int(np.argmax(env.reset(seed=seed)[0])), False
        while not ended:
            best = rng.choice(np.flatnonzero(q[state] == q[state].max()))
            action = int(rng.integers(4)) if rng.random() < 0.1 else int(best)
            obs, reward, terminated, truncated, _ = env.step(action)
            following = int(np.argmax(obs))
            goal = float(reward) + GAMMA * (not terminated) * q[following].max()
            q[state, action] += 0.5 * (goal - q[state, action])
            state, ended = following, terminated or truncated
        if reaches_goal(env.unwrapped, q):
            return episode + 1
    return np.inf


def reaches_goal(lake: gym.Env, q: np.ndarray) -> bool:
    """Whether the greedy policy reaches the goal, by the lake's transition table."""
    state = 0
    for _ in range(50):
        ((_, state, reward, ended),) = lake.P[state][int(np.argmax(q[state]))]  # type: ignore[attr-defined]
        if ended:
            return reward > 0
    return False


if __name__ == "__main__":
    main(tyro.cli(Options))
