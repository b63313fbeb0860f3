"""The networks of the peers: sizes, scales and initialisation of upslope's, and weights carried over."""

from typing import Any

import torch

from benchmarks.peers.numpy_cartpoles import SCALE, weights_of


class DuelingMLP(torch.nn.Module):
    """Two tanh layers, V head and A head, Q by Eq. 6."""

    def __init__(self, inputs: int = 4, actions: int = 2, hidden: int = 32):
        super().__init__()
        self.first = torch.nn.Linear(inputs, hidden)
        self.second = torch.nn.Linear(hidden, hidden)
        self.value = torch.nn.Linear(hidden, 1)
        self.advantage = torch.nn.Linear(hidden, actions)
        self.register_buffer("scale", torch.from_numpy(SCALE), persistent=False)

    def forward(self, obs: torch.Tensor) -> torch.Tensor:
        features = torch.tanh(self.first(obs * self.scale))
        features = torch.tanh(self.second(features))
        advantage = self.advantage(features)
        return self.value(features) + advantage - advantage.amax(dim=-1, keepdim=True)


class QMLP(torch.nn.Module):
    """Two ReLU layers and one number for each action: the vanilla Q-network."""

    def __init__(self, inputs: int = 4, actions: int = 2, hidden: int = 32):
        super().__init__()
        self.first = torch.nn.Linear(inputs, hidden)
        self.second = torch.nn.Linear(hidden, hidden)
        self.head = torch.nn.Linear(hidden, actions)
        self.register_buffer("scale", torch.from_numpy(SCALE), persistent=False)

    def forward(self, obs: torch.Tensor) -> torch.Tensor:
        features = torch.relu(self.first(obs * self.scale))
        return self.head(torch.relu(self.second(features)))


def carry_over(network: Any, peer: torch.nn.Module) -> torch.nn.Module:
    """Gives the peer upslope's weights."""
    peer.load_state_dict({name: torch.from_numpy(array) for name, array in weights_of(network).items()})
    return peer
