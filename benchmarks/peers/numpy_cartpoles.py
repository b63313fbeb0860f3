"""Many CartPoles stepped at once in numpy, as a careful author without JAX would write them; acting, and trials."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from upslope.envs.cartpole import CartPole, CartPoleParams
from upslope.envs.cartpole_physics import euler_equations
from upslope.networks.dueling import DuelingQ

MAX_STEPS = 200
SCALE = np.asarray(CartPole.observation_scale, np.float32)
_SHARED = CartPoleParams()


class CartPoles:
    """One CartPole for each pole length ``[n]``, with automatic reset, in single precision."""

    def __init__(self, lengths: np.ndarray, rng: np.random.Generator):
        lengths = np.asarray(lengths, np.float32)
        pole_mass = np.float32(_SHARED.pole_density) * lengths
        self.params = SimpleNamespace(
            half_length=lengths / 2,
            pole_mass=pole_mass,
            total_mass=np.float32(_SHARED.cart_mass) + pole_mass,
            gravity=np.float32(_SHARED.gravity),
            time_step=np.float32(_SHARED.time_step),
        )
        self.force = np.float32(_SHARED.force)
        self.angle_limit, self.track_limit = float(_SHARED.angle_limit), float(_SHARED.track_limit)
        self.rng = rng
        self.physics = self._fresh(len(lengths))
        self.time = np.zeros(len(lengths), int)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The true successors ``[n, 4]``, and which of them are terminal, which truncated ``[n]``."""
        angle = self.physics[:, 2]
        force = np.where(action == 1, self.force, -self.force)
        columns = euler_equations(tuple(self.physics.T), force, np.cos(angle), np.sin(angle), self.params)
        successors = np.stack(columns, axis=1).astype(np.float32)
        self.time += 1
        terminated = (np.abs(successors[:, 0]) > self.track_limit) | (np.abs(successors[:, 2]) > self.angle_limit)
        truncated = (self.time >= MAX_STEPS) & ~terminated
        done = terminated | truncated
        self.physics = successors
        if done.any():
            self.physics = np.where(done[:, None], self._fresh(len(done)), successors)
            self.time[done] = 0
        return successors, terminated, truncated

    def _fresh(self, count: int) -> np.ndarray:
        return self.rng.uniform(-0.05, 0.05, (count, 4)).astype(np.float32)


def weights_of(network: Any) -> dict[str, np.ndarray]:
    """Upslope's fully connected network by the names of the peers."""
    first, second = network.torso.layers
    layers = {"first": first, "second": second}
    if isinstance(network, DuelingQ):
        layers |= {"value": network.value_head, "advantage": network.advantage_head}
    else:
        layers["head"] = network.head
    found = {}
    for name, layer in layers.items():
        found |= {f"{name}.weight": np.array(layer.weight), f"{name}.bias": np.array(layer.bias)}
    return found


def numpy_advantages(weights: dict[str, Any]) -> Any:
    """A dueling tanh network's advantages ``[n, 4] -> [n, actions]``, from arrays by the names of `weights_of`."""
    arrays = {name: np.asarray(weight) for name, weight in weights.items()}

    def advantages(obs: np.ndarray) -> np.ndarray:
        features = np.tanh((obs * SCALE) @ arrays["first.weight"].T + arrays["first.bias"])
        features = np.tanh(features @ arrays["second.weight"].T + arrays["second.bias"])
        return features @ arrays["advantage.weight"].T + arrays["advantage.bias"]

    return advantages


def greedy_returns(advantages: Any, lengths: np.ndarray, seed: int = 0) -> np.ndarray:
    """The return of one greedy episode on each pole ``[n]``."""
    poles = CartPoles(lengths, np.random.default_rng(seed))
    alive, total = np.ones(len(lengths), bool), np.zeros(len(lengths))
    for _ in range(MAX_STEPS):
        total += alive
        _, terminated, truncated = poles.step(advantages(poles.physics).argmax(axis=1))
        alive &= ~(terminated | truncated)
    return total
