"""Policies of learners: small PyTrees that act on a batch of observations, so that any family can run them.

On the host a policy draws its noise for many steps at once, in one compiled call, and then acts in NumPy. The same keys
give the same actions.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from upslope.types import Acting, Key, Keys


class AbstractPolicy(eqx.Module):
    """A policy in two parts: it draws the noise of a step, which depends on nothing else, and then chooses actions.

    Attributes:
        network: has ``best(obs)``, the best action in one state, and, for acting on the host, ``numpy_best()``.
    """

    network: eqx.AbstractVar[Any]

    @abstractmethod
    def noise(self, key: Key, count: int) -> Any:
        """The random numbers of one step of ``count`` environments."""

    def noises(self, keys: Keys, count: int) -> Any:
        """The noise of many steps in a row, one for each key ``[steps, ...]``."""
        return jax.vmap(lambda key: self.noise(key, count))(keys)

    @abstractmethod
    def choose(self, noise: Any, best: Any, xp: Any) -> Any:
        """Actions ``[n, ...]`` from the noise and the best actions, with jax.numpy or numpy as ``xp``."""

    def __call__(self, key: Key, obs: Float[Array, "n *obs"]) -> Any:
        return self.choose(self.noise(key, len(obs)), jax.vmap(self.network.best)(obs), jnp)

    def ahead(self, keys: Keys, obs: Float[Array, "n *obs"]) -> tuple[Any, Callable[[Any, Any], Any]]:
        """The noise of many steps at once, and the policy as a function of one step's noise and observations.

        The actions are the same as when the policy is called with each of the keys. But a loop over steps that draws
        nothing has half the kernels, and with ten poles a step takes only the time of starting its kernels.

        Args:
            keys: one for each step ``[steps]``.
            obs: observations of any step; only the shape is used.
        """

        def act(noise: Any, obs: Float[Array, "n *obs"]) -> Any:
            return self.choose(noise, jax.vmap(self.network.best)(obs), jnp)

        return self.noises(keys, len(obs)), act

    def on_host(self, keys: Keys, count: int) -> Callable[[], Acting] | None:
        """A function that makes the policy in NumPy; None if the network has no such form. JAX draws the noise now.

        Args:
            keys: one for each step ``[steps]``.
            count: the number of environments.
        """
        numpy_best = getattr(self.network, "numpy_best", None)
        if numpy_best is None:
            return None
        noise = _compiled_noise(self, keys, count)
        return lambda: self._acting(numpy_best(), noise, len(keys))

    def _acting(self, best: Callable[[np.ndarray], np.ndarray], noise: Any, steps: int) -> Acting:
        leaves, structure = jax.tree.flatten(noise)
        # Split once: building a PyTree of one step's noise takes as long as evaluating the network.
        rows = list(zip(*(np.asarray(leaf) for leaf in leaves), strict=True)) if leaves else [()] * steps
        noises = [jax.tree.unflatten(structure, row) for row in rows]
        choose = type(self).choose  # looked up once: binding a method of a module takes longer than the choice

        def act(step: int, obs: np.ndarray) -> np.ndarray:
            return choose(self, noises[step], best(obs), np)

        return act


_compiled_noise = jax.jit(lambda policy, keys, count: policy.noises(keys, count), static_argnums=2)


class Greedy(AbstractPolicy):
    """The best action: the one with the highest Q(s, ·), or a deterministic actor's action."""

    network: Any

    def noise(self, key: Key, count: int) -> None:
        del key, count

    def choose(self, noise: None, best: Any, xp: Any) -> Any:
        del noise, xp
        return best


class EpsilonGreedy(AbstractPolicy):
    """A uniformly random action with probability ε (one ε, or one for each of the n), otherwise the best action.

    The network draws the random actions: ``random_actions(key, n)``.
    """

    network: Any
    epsilon: Float[Array, "..."] | float

    def noise(self, key: Key, count: int) -> tuple[Bool[Array, "n"], Any]:
        explore_key, action_key = jax.random.split(key)
        explore = jax.random.uniform(explore_key, (count,)) < self.epsilon
        return explore, self.network.random_actions(action_key, count)

    def choose(self, noise: Any, best: Any, xp: Any) -> Any:
        explore, anything = noise
        return xp.where(explore.reshape(-1, *(1,) * (anything.ndim - 1)), anything, best)


class HeldActions(EpsilonGreedy):
    """Temporally extended ε-greedy: a random action is begun with probability ε, and held for k steps.

    P(k) is proportional to k to the power −1.5, up to the longest hold. So exploration reaches what no sequence of
    independent random actions does, such as the hill of MountainCar. In a single step it is `EpsilonGreedy`.

    Attributes:
        longest: the longest hold, in steps.
    """

    longest: int = eqx.field(static=True)

    def noises(self, keys: Keys, count: int) -> tuple[Bool[Array, "steps n"], Any]:
        lengths = jnp.arange(1, self.longest + 1)
        shares = lengths**-1.5 / jnp.sum(lengths**-1.5)
        noise_keys, hold_keys = jnp.moveaxis(jax.vmap(jax.random.split)(keys), 1, 0)
        begins, actions = super().noises(noise_keys, count)
        holds = jax.vmap(lambda key: jax.random.choice(key, lengths, (count,), p=shares))(hold_keys)

        def one_step(held: tuple[Any, Any], drawn: tuple[Any, Any, Any]) -> tuple[Any, Any]:
            left, action = held
            begin, other, hold = drawn
            begin = begin & (left == 0)
            left = jnp.where(begin, hold, left)
            action = jnp.where(begin.reshape(-1, *(1,) * (other.ndim - 1)), other, action)
            return (jnp.maximum(left - 1, 0), action), (left > 0, action)

        start = (jnp.zeros(count, lengths.dtype), jax.tree.map(lambda leaf: jnp.zeros_like(leaf[0]), actions))
        return jax.lax.scan(one_step, start, (begins, actions, holds))[1]


class Noisy(AbstractPolicy):
    """A deterministic actor's action plus Gaussian noise of standard deviation σ, clipped to [−1, 1]."""

    network: Any
    sigma: Any

    def noise(self, key: Key, count: int) -> Float[Array, "n actions"]:
        return self.sigma * jax.random.normal(key, (count, self.network.actions))

    def choose(self, noise: Any, best: Any, xp: Any) -> Any:
        return xp.clip(best + noise, -1.0, 1.0)
