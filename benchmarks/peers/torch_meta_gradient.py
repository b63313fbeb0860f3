"""The outer gradient of Algorithm 1 with the convolutional network in PyTorch: a loop over tasks, and torch.func."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch.func import functional_call, grad, vmap
from torch.nn import functional

from upslope.networks.dueling import DuelingQ as OursDuelingQ
from upslope.types import Transition

Gradient = dict[str, torch.Tensor]


class DuelingQ(torch.nn.Module):
    """Four convolutions, two fully connected layers, the dueling heads with the maximum."""

    def __init__(self, shape: tuple[int, int, int], kernels: int, hidden: tuple[int, ...], actions: int):
        super().__init__()
        height, width, channels = shape
        inputs = (channels, kernels, kernels, kernels)
        self.convolutions = torch.nn.ModuleList(torch.nn.Conv2d(n, kernels, 3, padding=1) for n in inputs)
        widths = (height * width * kernels, *hidden)
        self.dense = torch.nn.ModuleList(torch.nn.Linear(n, m) for n, m in zip(widths[:-1], hidden, strict=True))
        self.heads = torch.nn.Linear(hidden[-1], 1 + actions)

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        for layer in self.convolutions:
            images = functional.relu(layer(images))
        features = images.flatten(1)
        for layer in self.dense:
            features = functional.relu(layer(features))
        value, advantage = self.heads(features).split([1, self.heads.out_features - 1], dim=1)
        return value + advantage - advantage.amax(dim=1, keepdim=True)


def torch_weights(network: OursDuelingQ, shape: tuple[int, int, int]) -> dict[str, np.ndarray]:
    """Upslope's network, or a gradient of it, by the peer's names and in its order of axes."""
    height, width, _ = shape
    found = {}
    for index, (kernel, bias) in enumerate(zip(network.torso.kernels, network.torso.biases, strict=True)):
        found[f"convolutions.{index}.weight"] = np.transpose(kernel, (3, 2, 0, 1))
        found[f"convolutions.{index}.bias"] = np.asarray(bias)
    for index, layer in enumerate(network.torso.dense.layers):
        weight = np.asarray(layer.weight)
        if index == 0:
            weight = weight.reshape(len(weight), height, width, -1).transpose(0, 3, 1, 2).reshape(len(weight), -1)
        found |= {f"dense.{index}.weight": weight, f"dense.{index}.bias": np.asarray(layer.bias)}
    for name in ("weight", "bias"):
        parts = [getattr(head, name) for head in (network.value_head, network.advantage_head)]
        found[f"heads.{name}"] = np.concatenate(parts)
    return found


def peer_steps(
    batch: Transition, ours: OursDuelingQ, step_size: float
) -> dict[str, Callable[[str], tuple[float, Gradient]]]:
    """By name: what computes the loss and the gradient for a target of Eq. 7 that is "stopped" or "kept".

    Args:
        batch: numpy arrays ``[tasks, batch, ...]``, images with the channels last.
        ours: upslope's network, whose weights are carried over.
        step_size: α.
    """
    shape = batch.obs.shape[2:]
    hidden, kernels = ours.torso.hidden, ours.torso.kernels[0].shape[-1]
    network = DuelingQ(shape, kernels, hidden, ours.advantage_head.weight.shape[0])
    theta = {name: torch.from_numpy(np.array(weight)) for name, weight in torch_weights(ours, shape).items()}
    data = (
        to_torch(batch.obs).permute(0, 1, 4, 2, 3).contiguous(),
        to_torch(batch.action).long(),
        to_torch(batch.reward),
        to_torch(batch.discount),
        to_torch(batch.next_obs).permute(0, 1, 4, 2, 3).contiguous(),
    )

    def q(params: Gradient, images: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        return functional_call(network, params, (images,)).gather(1, action[:, None])[:, 0]

    def inner_loss(params: Gradient, targets: torch.Tensor, images: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        return ((targets - q(params, images, action)) ** 2).mean()

    def outer_loss(params: Gradient, stopped: bool, gradient_of: Callable, *task: torch.Tensor) -> torch.Tensor:
        images, action, reward, discount, following = task
        frozen = {name: weight.detach() for name, weight in params.items()}
        targets = reward + discount * functional_call(network, frozen, (following,)).amax(dim=1)
        gradient = gradient_of(params, targets.detach(), images, action)
        phi = {name: weight - step_size * gradient[name] for name, weight in params.items()}
        q_posterior = q({name: w.detach() for name, w in phi.items()} if stopped else phi, images, action)
        return ((q(params, images, action) - q_posterior) ** 2).mean()

    def loop(target: str) -> tuple[float, Gradient]:
        stopped = target == "stopped"

        def gradient_of(params: Gradient, *rest: torch.Tensor) -> Gradient:
            found = torch.autograd.grad(inner_loss(params, *rest), tuple(params.values()), create_graph=not stopped)
            return dict(zip(params, found, strict=True))

        params = {name: weight.clone().requires_grad_() for name, weight in theta.items()}
        total = 0.0
        for task in zip(*data, strict=True):
            loss = outer_loss(params, stopped, gradient_of, *task) / len(data[0])
            loss.backward()
            total += float(loss.detach())
        return total, {name: weight.grad for name, weight in params.items() if weight.grad is not None}

    def by_func(target: str) -> tuple[float, Gradient]:
        def one_task(params: Gradient, *task: torch.Tensor) -> torch.Tensor:
            return outer_loss(params, target == "stopped", grad(inner_loss), *task)

        per_task = vmap(one_task, in_dims=(None, 0, 0, 0, 0, 0))

        def mean_loss(params: Gradient) -> tuple[torch.Tensor, torch.Tensor]:
            loss = per_task(params, *data).mean()
            return loss, loss.detach()

        gradient, loss = grad(mean_loss, has_aux=True)(theta)
        return float(loss), gradient

    return {"PyTorch, loop over tasks": loop, "PyTorch, torch.func": by_func}


def to_torch(array: Any) -> torch.Tensor:
    """A copy that torch may write to."""
    return torch.from_numpy(np.array(array))
