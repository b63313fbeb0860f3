"""Algorithm 1 in PyTorch and Gymnasium as one writes it down: a loop over tasks, one environment step at a time.

The recipe is upslope's default one (`upslope.meta_training.recipes.MetaTrainingConfig`), so that both learn the same.
"""

import copy
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import torch
from torch.func import functional_call

import upslope  # noqa: F401 (registers the environment)
from benchmarks.peers.torch_networks import DuelingMLP
from upslope.meta_training.config import MetaTrainingConfig


class Batch(NamedTuple):
    """Transitions ``[n, ...]``; the discount is γ·(1 − terminated)."""

    obs: torch.Tensor
    action: torch.Tensor
    reward: torch.Tensor
    discount: torch.Tensor
    next_obs: torch.Tensor

    def sample(self, count: int, rng: np.random.Generator) -> "Batch":
        """Draws with replacement."""
        chosen = torch.from_numpy(rng.integers(len(self.reward), size=count))
        return Batch(*(column[chosen] for column in self))


class PlainMetaTraining:
    """Algorithm 1, one seed; the posterior of the config is the whole network."""

    def __init__(self, config: MetaTrainingConfig, seed: int = 0, gamma: float = 0.98, low: float = 0.25):
        torch.manual_seed(seed)
        self.config, self.gamma, self.low = config, gamma, low
        self.posterior: Any = config.posterior
        self.rng = np.random.default_rng(seed)
        self.theta = DuelingMLP(hidden=config.hidden[0])
        self.target, self.average = copy.deepcopy(self.theta), copy.deepcopy(self.theta)
        self.optimiser = torch.optim.Adam(self.theta.parameters(), lr=config.outer_step_size)
        self.updates = 0

    def iterate(self, iterations: int) -> None:
        """Meta-iterations."""
        for _ in range(iterations):
            epsilons = np.linspace(*self.config.epsilon, self.config.tasks)
            replays = [self.collect(self.rng.uniform(self.low, 5.0), epsilon) for epsilon in epsilons]
            for _ in range(self.config.outer_updates):
                self.outer_step([replay.sample(self.posterior.batch_size, self.rng) for replay in replays])
            move(self.target, self.theta, 1 - (self.posterior.target_decay or 0.0))
            move(self.average, self.theta, 1 - self.config.averaging)

    def collect(self, length: float, epsilon: float) -> Batch:
        """A fresh replay of one task, ε-greedy by Q_θ."""
        env = gym.make("upslope/CartPole-v0", length=length)
        obs, _ = env.reset(seed=int(self.rng.integers(2**31)))
        rows = []
        for _ in range(self.config.steps_per_task):
            if self.rng.random() < epsilon:
                action = int(self.rng.integers(2))
            else:
                with torch.no_grad():
                    action = int(self.theta(torch.as_tensor(obs)).argmax())
            following, reward, terminated, truncated, _ = env.step(action)
            rows.append((obs, action, reward, self.gamma * (1.0 - terminated), following))
            obs = env.reset()[0] if terminated or truncated else following
        obs_, action_, reward_, discount_, next_ = zip(*rows, strict=True)
        return Batch(
            torch.as_tensor(np.array(obs_)),
            torch.as_tensor(action_),
            torch.as_tensor(reward_, dtype=torch.float32),
            torch.as_tensor(discount_, dtype=torch.float32),
            torch.as_tensor(np.array(next_)),
        )

    def outer_step(self, batches: list[Batch]) -> float:
        """One step of Adam on Eq. 7, averaged over tasks; returns the loss."""
        for group in self.optimiser.param_groups:
            group["lr"] = outer_step_size(self.config, self.updates)
        self.optimiser.zero_grad()
        total = 0.0
        for batch in batches:
            loss = self.outer_loss(batch) / len(batches)
            loss.backward()
            total += float(loss.detach())
        self.optimiser.step()
        self.updates += 1
        return total

    def outer_loss(self, batch: Batch) -> torch.Tensor:
        """Eq. 7, with φ adapted by N steps on Eq. 5; Q_φ is a constant."""
        with torch.no_grad():
            targets = batch.reward + batch.discount * self.target(batch.next_obs).amax(dim=1)
        phi = dict(self.theta.named_parameters())
        for _ in range(self.posterior.inner_steps):
            inner = ((targets - taken(functional_call(self.theta, phi, (batch.obs,)), batch.action)) ** 2).mean()
            gradients = torch.autograd.grad(inner, tuple(phi.values()))
            steps = zip(phi.items(), gradients, strict=True)
            phi = {name: weight - self.posterior.inner_step_size * gradient for (name, weight), gradient in steps}
        posterior = taken(functional_call(self.theta, phi, (batch.obs,)), batch.action).detach()
        return ((taken(self.theta(batch.obs), batch.action) - posterior) ** 2).mean()


def taken(q: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
    """Q(s, a) of the actions taken."""
    return q.gather(-1, action[..., None])[..., 0]


def outer_step_size(config: MetaTrainingConfig, update: int) -> float:
    """β falls linearly from the first outer update to the last."""
    share = min(update / (config.iterations * config.outer_updates), 1.0)
    return config.outer_step_size + share * (config.outer_step_size_end - config.outer_step_size)


def move(network: torch.nn.Module, towards: torch.nn.Module, rate: float) -> None:
    """A moving average of weights."""
    with torch.no_grad():
        for slow, fast in zip(network.parameters(), towards.parameters(), strict=True):
            slow.lerp_(fast, rate)
