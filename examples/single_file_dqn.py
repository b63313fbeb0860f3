"""A DQN in one file, on a vector of poles of different lengths, with and without shaping. Needs torch.

``python examples/single_file_dqn.py [--quick]``. The shaping is one line; the rest is any DQN.
"""

from dataclasses import dataclass

import gymnasium as gym
import numpy as np
import torch
import tyro
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from torch import nn

import upslope


@dataclass(frozen=True)
class Options:
    """What to run."""

    lengths: tuple[float, ...] = (0.8, 1.7, 3.1, 4.6)
    """Lengths of the poles; one network learns all of them."""
    steps: int = 3000
    """Steps in every environment."""
    seed: int = 0
    quick: bool = False
    """A short run, to check that everything works."""


def main(options: Options) -> None:
    """Trains twice, and prints the mean raw return of the last twenty episodes; the maximum is 200."""
    prior = upslope.load_prior("cartpole")
    for shaped in (False, True):
        returns = train(options, prior, shaped)
        print(f"{'shaped' if shaped else 'unshaped'}: raw return {np.mean(returns[-20:]):.1f}")


def train(options: Options, prior: upslope.Prior, shaped: bool) -> list[float]:
    """One run: the raw return of every episode."""
    torch.manual_seed(options.seed)
    rng = np.random.default_rng(options.seed)
    makers = [lambda length=length: gym.make("upslope/CartPole-v0", length=length) for length in options.lengths]
    # Same-step autoreset: every step is a transition, and the true successor is in final_obs.
    envs = SyncVectorEnv(makers, autoreset_mode=AutoresetMode.SAME_STEP)
    if shaped:
        envs = upslope.shape(envs, prior, gamma=prior.gamma)
    count = envs.num_envs
    network, target = (nn.Sequential(nn.Linear(4, 64), nn.ReLU(), nn.Linear(64, 2)) for _ in range(2))
    target.load_state_dict(network.state_dict())
    optimiser = torch.optim.Adam(network.parameters(), lr=1e-3)
    replay: list[tuple] = []
    running, returns = np.zeros(count), []
    obs, _ = envs.reset(seed=options.seed)
    steps = 100 if options.quick else options.steps
    for step in range(steps):
        greedy = network(torch.as_tensor(obs)).argmax(1).numpy()
        explore = rng.random(count) < max(0.05, 1 - step / (0.2 * steps))
        actions = np.where(explore, rng.integers(0, 2, count), greedy)
        following, rewards, terminated, truncated, infos = envs.step(actions)
        done = terminated | truncated
        successors = following.copy()
        for i in np.flatnonzero(done):
            successors[i] = infos["final_obs"][i]
        replay += list(zip(obs, actions, rewards, successors, terminated, strict=True))
        running += infos.get("raw_reward", rewards)  # report raw returns only
        returns += running[done].tolist()
        running[done] = 0.0
        obs = following
        if len(replay) >= 128:
            batch = [replay[i] for i in rng.integers(0, len(replay), 64)]
            s, a, r, s_next, end = (torch.as_tensor(np.asarray(part)) for part in zip(*batch, strict=True))
            with torch.no_grad():
                goal = r.float() + prior.gamma * ~end * target(s_next).amax(1)
            loss = nn.functional.smooth_l1_loss(network(s).gather(1, a[:, None])[:, 0], goal)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
        if step % 50 == 0:
            target.load_state_dict(network.state_dict())
    envs.close()
    return returns


if __name__ == "__main__":
    main(tyro.cli(Options))
