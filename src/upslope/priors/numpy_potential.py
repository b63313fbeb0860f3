"""A prior's potential in NumPy, for simulator processes that evaluate it at every step. Needs no JAX."""

from pathlib import Path

import numpy as np
from jaxtyping import Float, Shaped

from upslope.networks.numpy_torsos import numpy_torso_for
from upslope.priors.prior_file import TrainedOn, read_prior_file


class NumpyPotential:
    """Φ(s) = V_θ(s) of a saved prior, in float64; one vector costs a few microseconds.

    It is immutable, compared by value, and small: copies and pickles contain only the parameters and the header.

    Attributes:
        trained_on: what the prior was trained on.
    """

    def __init__(self, trained_on: TrainedOn, tensors: dict[str, np.ndarray]):
        """Takes the tensors of a prior's file by name. `Prior.to_numpy` and `load` call this."""
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
        """The γ with which the potential was learned, and which shaping with it requires."""
        return self.trained_on.gamma

    def __call__(self, obs: Shaped[np.ndarray, "*obs"]) -> float:
        """Φ of one observation."""
        return float(self._head.dot(self._torso.one(self._normalise(obs)))) + self._head_bias

    def values(self, obs: Shaped[np.ndarray, "n *obs"]) -> Float[np.ndarray, "n"]:
        """Φ of a batch of observations."""
        return self._torso.batch(self._normalise(obs)) @ self._head + self._head_bias

    def _prepare(self) -> None:
        """Converts the parameters to double precision."""
        about, tensors = self.trained_on, self._tensors
        torso = numpy_torso_for(about.observation_shape)
        self._torso = torso(tensors, about.hidden, about.observation_scale, about.activation)
        unit = float(tensors["scaling.unit"]) if about.scaled else 1.0
        self._head = unit * tensors["value_head.weight"][0].astype(np.float64)
        self._head_bias = unit * float(tensors["value_head.bias"][0])
        if about.scaled:
            self._head_bias += float(tensors["scaling.level"])
            self._mean, self._deviation = (
                tensors[f"scaling.{name}"].astype(np.float64) for name in ("mean", "deviation")
            )

    def _normalise(self, obs: np.ndarray) -> np.ndarray:
        return (obs - self._mean) / self._deviation if self.trained_on.scaled else obs

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
