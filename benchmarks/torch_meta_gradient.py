"""The peer of `benchmarks.meta_gradient`: the same outer gradient in PyTorch, with the same network and transitions."""

from collections.abc import Callable

import numpy as np
import torch
from torch.func import functional_call, grad, vmap
from torch.nn import functional

from upslope.types import Transition


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


def peer_steps(
    batch: Transition, kernels: int, hidden: tuple[int, ...], actions: int, step_size: float = 0.05
) -> dict[str, tuple[str, Callable[[], object]]]:
    """A loop over tasks with ``torch.autograd``, and ``torch.func`` over all tasks; by name, with what is stopped."""
    torch.manual_seed(0)
    height, width, channels = batch.obs.shape[2:]
    network = DuelingQ((height, width, channels), kernels, hidden, actions)
    theta = {name: weight.detach() for name, weight in network.named_parameters()}
    to_torch = lambda array: torch.from_numpy(np.array(array))  # noqa: E731
    data = (
        to_torch(batch.obs).permute(0, 1, 4, 2, 3).contiguous(),
        to_torch(batch.action).long(),
        to_torch(batch.reward),
        to_torch(batch.discount),
        to_torch(batch.next_obs).permute(0, 1, 4, 2, 3).contiguous(),
    )

    def q(params: dict, images: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        return functional_call(network, params, (images,)).gather(1, action[:, None])[:, 0]

    def inner_loss(params: dict, targets: torch.Tensor, images: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        return ((targets - q(params, images, action)) ** 2).mean()

    def outer_loss(params: dict, stopped: bool, gradient_of: Callable, *task: torch.Tensor) -> torch.Tensor:
        images, action, reward, discount, following = task
        frozen = {name: weight.detach() for name, weight in params.items()}
        targets = reward + discount * functional_call(network, frozen, (following,)).amax(dim=1)
        gradient = gradient_of(params, targets.detach(), images, action)
        phi = {name: weight - step_size * gradient[name] for name, weight in params.items()}
        q_posterior = q({name: w.detach() for name, w in phi.items()} if stopped else phi, images, action)
        return ((q(params, images, action) - q_posterior) ** 2).mean()

    def loop(stopped: bool) -> object:
        def gradient_of(params: dict, *rest: torch.Tensor) -> dict:
            found = torch.autograd.grad(inner_loss(params, *rest), tuple(params.values()), create_graph=not stopped)
            return dict(zip(params, found, strict=True))

        params = {name: weight.clone().requires_grad_() for name, weight in theta.items()}
        for task in zip(*data, strict=True):
            (outer_loss(params, stopped, gradient_of, *task) / len(data[0])).backward()
        return params

    def by_func(stopped: bool) -> object:
        per_task = vmap(
            lambda params, *task: outer_loss(params, stopped, grad(inner_loss), *task), in_dims=(None, 0, 0, 0, 0, 0)
        )
        return grad(lambda params: per_task(params, *data).mean())(theta)

    return {
        f"PyTorch {torch.__version__}, {how}, {target}": (target, lambda run=run, s=target == "stopped": run(s))
        for target in ("stopped", "kept")
        for how, run in (("loop over tasks", loop), ("torch.func", by_func))
    }
