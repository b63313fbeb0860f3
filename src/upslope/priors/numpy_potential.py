"""A prior's potential in plain numpy: what a simulator process evaluates at every step. Needs no JAX."""

from pathlib import Path

import numpy as np
from jaxtyping import Float, Shaped

from upslope.networks.numpy_convolution import CHANNELS, convolve
from upslope.priors.prior_file import TrainedOn, read_prior_file


class NumpyPotential:
    """Φ(s) = V_θ(s) of a saved prior, in float64; one vector costs a few microseconds.

    Immutable, compared by value, and small: copies and pickles hold the parameters and nothing else.

    Attributes:
        trained_on: what the prior was trained on.
    """

    def __init__(self, trained_on: TrainedOn, tensors: dict[str, np.ndarray]):
        """Takes the tensors of a prior's file by their names; `Prior.to_numpy` and `load` call this."""
        self.trained_on = trained_on
        self._tensors = tensors
        self._prepare()

    @classmethod
    def load(cls, path: str | Path) -> "NumpyPotential":
        """Reads a file that `Prior.save` wrote.

        Raises:
            UpslopeError: a missing, damaged, foreign or newer file, or one with non-finite parameters.
        """
        return cls(*read_prior_file(Path(path)))

    @property
    def gamma(self) -> float:
        """γ that the potential was learned with, and that shaping by it needs."""
        return self.trained_on.gamma

    def __call__(self, obs: Shaped[np.ndarray, "*obs"]) -> float:
        """Φ of one observation."""
        if self._kernels:
            return float(self.values(np.asarray(obs)[None])[0])
        features = obs
        # The vector form of `values`: without the batch axis numpy's calls cost half as much.
        for weight, bias in self._layers:
            features = weight.dot(features)
            features += bias
            self._activate(features, features)
        return float(self._head.dot(features)) + self._head_bias

    def values(self, obs: Shaped[np.ndarray, "n *obs"]) -> Float[np.ndarray, "n"]:
        """Φ of a batch of observations."""
        features = np.asarray(obs, np.float64)
        for kernel, bias in self._kernels:
            features = convolve(features, kernel)
            features += bias
            self._activate(features, features)
        features = features.reshape(len(features), -1)
        for weight, bias in self._layers:
            features = features @ weight.T
            features += bias
            self._activate(features, features)
        return features @ self._head + self._head_bias

    def _prepare(self) -> None:
        """The parameters in double precision; the fixed scale of the inputs goes into the first layer's weights."""
        about = self.trained_on
        tensors = {name: tensor.astype(np.float64) for name, tensor in self._tensors.items()}
        scale = np.asarray(about.observation_scale)
        is_image = len(about.observation_shape) == 3
        prefix = "torso.dense.layers" if is_image else "torso.layers"
        self._kernels: list[tuple[np.ndarray, np.ndarray]] = []
        if is_image:
            names = [(f"torso.kernels.{i}", f"torso.biases.{i}") for i in range(len(CHANNELS))]
            self._kernels = [(tensors[kernel], tensors[bias]) for kernel, bias in names]
            kernel, bias = self._kernels[0]
            self._kernels[0] = (kernel * scale[:, None], bias)
        names = [(f"{prefix}.{i}.weight", f"{prefix}.{i}.bias") for i in range(len(about.hidden))]
        self._layers = [(tensors[weight], tensors[bias]) for weight, bias in names]
        if not is_image:
            weight, bias = self._layers[0]
            self._layers[0] = (weight * scale, bias)
        self._head = tensors["value_head.weight"][0]
        self._head_bias = float(tensors["value_head.bias"][0])
        self._activate = np.tanh if about.activation == "tanh" else _relu

    def __getstate__(self) -> dict:
        return {"trained_on": self.trained_on, "_tensors": self._tensors}

    def __setstate__(self, state: dict) -> None:
        self.__dict__.update(state)
        self._prepare()

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, NumpyPotential):
            return NotImplemented
        same = self._tensors.keys() == other._tensors.keys() and self.trained_on == other.trained_on
        return same and all(np.array_equal(ours, other._tensors[name]) for name, ours in self._tensors.items())

    def __hash__(self) -> int:
        return hash(tuple((name, tensor.tobytes()) for name, tensor in sorted(self._tensors.items())))

    def __repr__(self) -> str:
        return f"NumpyPotential(family={self.trained_on.family!r}, gamma={self.gamma}, seed={self.trained_on.seed})"


def _relu(features: np.ndarray, out: np.ndarray) -> np.ndarray:
    return np.maximum(features, 0.0, out=out)
