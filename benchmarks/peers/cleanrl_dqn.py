"""DQN in one loop, in CleanRL's manner: PyTorch, Gymnasium, numpy arrays as the replay.

The settings are those of `upslope.learners.dqn`.
"""

import copy

import gymnasium as gym
import numpy as np
import torch

from benchmarks.peers.torch_networks import QMLP
from upslope.learners.dqn import DQNConfig


class CleanDQN:
    """One learner on one environment, whose rewards may be shaped by a wrapper."""

    def __init__(self, env: gym.Env, config: DQNConfig, seed: int = 0, gamma: float = 0.98):
        torch.manual_seed(seed)
        self.env, self.config, self.gamma = env, config, gamma
        self.rng = np.random.default_rng(seed)
        self.network = QMLP(hidden=config.hidden[0])
        self.target = copy.deepcopy(self.network)
        self.optimiser = torch.optim.Adam(self.network.parameters(), lr=config.learning_rate)
        capacity = config.replay_capacity
        self.obs, self.next_obs = np.zeros((2, capacity, 4), np.float32)
        self.action = np.zeros(capacity, np.int64)
        self.reward, self.discount = np.zeros((2, capacity), np.float32)
        self.added = self.updates = 0
        self.now, _ = env.reset(seed=seed)
        for _ in range(config.warmup_steps):
            self.act(1.0)

    def learn(self, updates: int) -> None:
        """Environment steps, each followed by an update."""
        for _ in range(updates):
            for _ in range(self.config.steps_per_update):
                self.act(self.config.epsilon)
            chosen = self.rng.integers(min(self.added, len(self.reward)), size=self.config.batch_size)
            columns = (self.obs, self.action, self.reward, self.discount, self.next_obs)
            self.update(*(torch.from_numpy(column[chosen]) for column in columns))

    def act(self, epsilon: float) -> None:
        """One step, remembered."""
        if self.rng.random() < epsilon:
            action = int(self.rng.integers(2))
        else:
            with torch.no_grad():
                action = int(self.network(torch.from_numpy(self.now)).argmax())
        following, reward, terminated, truncated, _ = self.env.step(action)
        where = self.added % len(self.reward)
        self.obs[where], self.action[where], self.next_obs[where] = self.now, action, following
        self.reward[where], self.discount[where] = reward, self.gamma * (1.0 - terminated)
        self.added += 1
        self.now = self.env.reset()[0] if terminated or truncated else following

    def update(self, *batch: torch.Tensor) -> float:
        """One step of Adam, then the target network follows; returns the loss."""
        if self.config.decay_updates:
            for group in self.optimiser.param_groups:
                group["lr"] = self.config.learning_rate * max(0.0, 1 - self.updates / self.config.decay_updates)
        loss = self.loss(*batch)
        self.optimiser.zero_grad()
        loss.backward()
        self.optimiser.step()
        with torch.no_grad():
            for slow, fast in zip(self.target.parameters(), self.network.parameters(), strict=True):
                slow.lerp_(fast, self.config.target_rate)
        self.updates += 1
        return float(loss.detach())

    def loss(
        self,
        obs: torch.Tensor,
        action: torch.Tensor,
        reward: torch.Tensor,
        discount: torch.Tensor,
        next_obs: torch.Tensor,
    ) -> torch.Tensor:
        """Mean Huber loss of the TD errors; twice torch's, which halves it."""
        with torch.no_grad():
            targets = reward + discount * self.target(next_obs).amax(dim=1)
        q = self.network(obs).gather(1, action[:, None])[:, 0]
        return 2 * torch.nn.functional.huber_loss(q, targets, delta=self.config.huber_threshold)
