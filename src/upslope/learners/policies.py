"""How learners act: policies are small PyTrees over a batch of observations, so that any family can run them.

On the host a policy draws its noise for many steps at once, in one compiled call, and then acts in numpy: the same
actions for the same keys.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from upslope.networks.numpy_networks import has_numpy_form, numpy_batch
from upslope.types import Acting, Key, Keys


class AbstractPolicy(eqx.Module):
    """A policy in two parts: the noise of a step, which depends on nothing else, and what is done with it.

    Attributes:
        order_only: whether nothing counts of the outputs but which is the largest.
        network: scores of the actions, or the action itself, of one observation.
    """

    order_only: ClassVar[bool] = False

    network: eqx.AbstractVar[Callable[..., Float[Array, "..."]]]

    @abstractmethod
    def noise(self, key: Key, shape: tuple[int, ...]) -> Any:
        """What is drawn for one step, for outputs of the network of this shape ``[n, actions]``."""

    @abstractmethod
    def choose(self, noise: Any, outputs: Any, xp: Any) -> Any:
        """Actions ``[n, ...]`` from the network's outputs ``[n, actions]``, with jax.numpy or numpy as ``xp``."""

    def __call__(self, key: Key, obs: Float[Array, "n *obs"]) -> Any:
        outputs = jax.vmap(self.network)(obs)
        return self.choose(self.noise(key, outputs.shape), outputs, jnp)

    def ahead(self, keys: Keys, obs: Float[Array, "n *obs"]) -> tuple[Any, Callable[[Any, Any], Any]]:
        """The noise of many steps at once, and the policy as a function of one step's noise and observations.

        The same actions as calling the policy with each of the keys; but a loop over steps that draws nothing has half
        the kernels, and where ten poles are balanced starting a kernel is all that it costs.

        Args:
            keys: one for each step ``[steps]``.
            obs: of any step: what counts is the shape.
        """
        shape = jax.eval_shape(jax.vmap(self.network), obs).shape

        def act(noise: Any, obs: Float[Array, "n *obs"]) -> Any:
            return self.choose(noise, jax.vmap(self.network)(obs), jnp)

        return _noises_of_steps(self, keys, shape), act

    def on_host(self, keys: Keys, shape: tuple[int, ...]) -> Callable[[], Acting] | None:
        """What makes the policy in numpy; None if it has no such form. JAX draws the noise from now on.

        Args:
            keys: one for each step ``[steps]``.
            shape: of the network's outputs ``[n, actions]``.
        """
        if not has_numpy_form(self.network):
            return None
        noises = _noises(self, keys, shape)
        return lambda: self._acting(noises, len(keys))

    def _acting(self, noises: Any, steps: int) -> Acting:
        network = numpy_batch(self.network, order_only=self.order_only)
        leaves, structure = jax.tree.flatten(noises)
        # Taken apart at once: a PyTree of one step's noise costs as much to make as the network to evaluate.
        rows = list(zip(*(np.asarray(leaf) for leaf in leaves), strict=True)) if leaves else [()] * steps
        noise = [jax.tree.unflatten(structure, row) for row in rows]
        choose = type(self).choose  # looked up once: binding a method of a module costs more than the choice

        def act(step: int, obs: np.ndarray) -> np.ndarray:
            return choose(self, noise[step], network(obs), np)

        return act


def _noises_of_steps(policy: AbstractPolicy, keys: Keys, shape: tuple[int, ...]) -> Any:
    return jax.vmap(lambda key: policy.noise(key, shape))(keys)


_noises = jax.jit(_noises_of_steps, static_argnames="shape")


class Greedy(AbstractPolicy):
    """The action of the highest score: Q(s, ·) or A(s, ·)."""

    order_only: ClassVar[bool] = True

    network: Callable[..., Float[Array, "actions"]]

    def noise(self, key: Key, shape: tuple[int, ...]) -> None:
        del key, shape

    def choose(self, noise: None, outputs: Any, xp: Any) -> Any:
        del noise, xp
        return outputs.argmax(-1)  # the method: NumPy's function of the name takes five times as long to begin


class EpsilonGreedy(AbstractPolicy):
    """A uniformly random action with probability ε (one for all, or one for each of the n), else the greedy one."""

    order_only: ClassVar[bool] = True

    network: Callable[..., Float[Array, "actions"]]
    epsilon: Float[Array, "..."] | float

    def noise(self, key: Key, shape: tuple[int, ...]) -> tuple[Any, Int[Array, "n"]]:
        explore_key, action_key = jax.random.split(key)
        explore = jax.random.uniform(explore_key, shape[:1]) < self.epsilon
        return explore, jax.random.randint(action_key, shape[:1], 0, shape[-1])

    def choose(self, noise: Any, outputs: Any, xp: Any) -> Any:
        explore, anything = noise
        return xp.where(explore, anything, outputs.argmax(-1))


class Noisy(AbstractPolicy):
    """A deterministic actor's action plus Gaussian noise of standard deviation σ, clipped to [−1, 1]."""

    network: Callable[..., Float[Array, "actions"]]
    sigma: Any

    def noise(self, key: Key, shape: tuple[int, ...]) -> Float[Array, "n actions"]:
        return self.sigma * jax.random.normal(key, shape)

    def choose(self, noise: Any, outputs: Any, xp: Any) -> Any:
        return xp.clip(outputs + noise, -1.0, 1.0)


class Deterministic(AbstractPolicy):
    """A deterministic actor's own action."""

    network: Callable[..., Float[Array, "actions"]]

    def noise(self, key: Key, shape: tuple[int, ...]) -> None:
        del key, shape

    def choose(self, noise: None, outputs: Any, xp: Any) -> Any:
        del noise
        return outputs
