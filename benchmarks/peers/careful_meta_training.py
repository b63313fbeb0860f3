"""Algorithm 1 in PyTorch by somebody who cares for speed: environments in one batch, tasks in one map.

Acting is numpy too, on the same memory as the weights: a torch call on ten observations costs several times as much.
"""

import copy
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch.func import functional_call, grad, vmap

from benchmarks.peers.numpy_cartpoles import CartPoles, numpy_advantages
from benchmarks.peers.plain_meta_training import Batch, move, outer_step_size, taken
from benchmarks.peers.torch_networks import DuelingMLP
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.posteriors import NetworkPosterior

Params = dict[str, torch.Tensor]


class CarefulMetaTraining:
    """Algorithm 1, one seed; the posterior of the config is the whole network.

    Attributes:
        compiled: whether one outer gradient, the same shapes each time, goes through ``torch.compile``.
    """

    def __init__(self, config: MetaTrainingConfig, seed: int = 0, gamma: float = 0.98, *, compiled: bool = False):
        torch.manual_seed(seed)
        self.config, self.gamma = config, gamma
        self.posterior: Any = config.posterior
        self.rng = np.random.default_rng(seed)
        self.theta = DuelingMLP(hidden=config.hidden[0])
        self.target, self.average = copy.deepcopy(self.theta), copy.deepcopy(self.theta)
        self.optimiser = torch.optim.Adam(self.theta.parameters(), lr=config.outer_step_size, foreach=True)
        self.outer_gradient: Callable[..., Any] = outer_gradient_of(self.posterior, self.theta)
        if compiled:
            self.outer_gradient = torch.compile(self.outer_gradient, dynamic=False)
        self.updates = 0

    def iterate(self, iterations: int) -> None:
        """Meta-iterations."""
        for _ in range(iterations):
            replay = self.collect()
            for _ in range(self.config.outer_updates):
                chosen = self.rng.integers(
                    self.config.steps_per_task, size=(self.config.tasks, self.posterior.batch_size)
                )
                tasks = np.arange(self.config.tasks)[:, None]
                self.outer_step(Batch(*(torch.from_numpy(column[tasks, chosen]) for column in replay)))
            move(self.target, self.theta, 1 - (self.posterior.target_decay or 0.0))
            move(self.average, self.theta, 1 - self.config.averaging)

    def collect(self) -> tuple[np.ndarray, ...]:
        """Fresh replays ``[tasks, steps, ...]``, ε-greedy by Q_θ: obs, action, reward, discount, next_obs."""
        tasks, steps = self.config.tasks, self.config.steps_per_task
        poles = CartPoles(self.rng.uniform(0.25, 5.0, tasks), self.rng)
        advantages = numpy_advantages({name: weight.detach() for name, weight in self.theta.named_parameters()})
        explores = self.rng.random((steps, tasks)) < np.linspace(*self.config.epsilon, tasks)
        anything = self.rng.integers(2, size=(steps, tasks))
        obs, following = np.empty((2, tasks, steps, 4), np.float32)
        action, terminal = np.empty((tasks, steps), np.int64), np.empty((tasks, steps), bool)
        for step in range(steps):
            obs[:, step] = poles.physics
            chosen = np.where(explores[step], anything[step], advantages(poles.physics).argmax(axis=1))
            action[:, step] = chosen
            following[:, step], terminal[:, step], _ = poles.step(chosen)
        discount = (self.gamma * (1.0 - terminal)).astype(np.float32)
        return obs, action, np.ones_like(discount), discount, following

    def outer_step(self, batch: Batch) -> float:
        """One step of Adam on Eq. 7 of all tasks ``[tasks, batch, ...]`` at once; returns the loss."""
        for group in self.optimiser.param_groups:
            group["lr"] = outer_step_size(self.config, self.updates)
        theta = {name: weight.detach() for name, weight in self.theta.named_parameters()}
        target = {name: weight.detach() for name, weight in self.target.named_parameters()}
        gradient, loss = self.outer_gradient(theta, target, *batch)
        for name, weight in self.theta.named_parameters():
            weight.grad = gradient[name]
        self.optimiser.step()
        self.updates += 1
        return float(loss)


def outer_gradient_of(posterior: NetworkPosterior, network: torch.nn.Module) -> Callable[..., tuple[Params, Any]]:
    """The outer gradient and loss, a function of θ, of the averaged network, and of a batch ``[tasks, batch, ...]``."""

    def q(params: Params, obs: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        return taken(functional_call(network, params, (obs,)), action)

    def inner_loss(params: Params, obs: torch.Tensor, action: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
        return ((targets - q(params, obs, action)) ** 2).mean()

    def posterior_q(theta: Params, obs: torch.Tensor, action: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
        phi = theta
        for _ in range(posterior.inner_steps):
            gradient = grad(inner_loss)(phi, obs, action, targets)
            phi = {name: weight - posterior.inner_step_size * gradient[name] for name, weight in phi.items()}
        return q(phi, obs, action)

    def outer_gradient(
        theta: Params,
        target: Params,
        obs: torch.Tensor,
        action: torch.Tensor,
        reward: torch.Tensor,
        discount: torch.Tensor,
        next_obs: torch.Tensor,
    ) -> tuple[Params, torch.Tensor]:
        targets = reward + discount * functional_call(network, target, (next_obs,)).amax(dim=-1)
        aim = vmap(posterior_q, in_dims=(None, 0, 0, 0))(theta, obs, action, targets)

        def outer_loss(theta: Params) -> tuple[torch.Tensor, torch.Tensor]:
            loss = ((q(theta, obs, action) - aim) ** 2).mean()
            return loss, loss.detach()

        return grad(outer_loss, has_aux=True)(theta)

    return outer_gradient
