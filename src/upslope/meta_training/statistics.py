"""What random steps show of a family's numbers: how far observations spread, and how large returns are."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from upslope.networks.scaling import Scaling
from upslope.types import Transition

#: The network's Q is to be of this order: so large are the returns of random steps in its units.
_ORDER_OF_Q = 10.0

#: Nothing that the random steps show lies further from the mean than so many deviations.
_FARTHEST = 10.0


class Statistics(eqx.Module):
    """Running measurements, over all steps so far.

    Attributes:
        count: the number of observations.
        mean: of each component of the observations, or of each channel of images.
        squares: the sum of the squared differences from the mean.
        low: the lowest value.
        high: the highest value.
        largest_return: the size of a large return or reward, in units of the return.
        reward: the mean reward.
        discount: the mean discount, with zeros where episodes terminated.
    """

    count: Float[Array, "*batch"]
    mean: Float[Array, "*batch inputs"]
    squares: Float[Array, "*batch inputs"]
    low: Float[Array, "*batch inputs"]
    high: Float[Array, "*batch inputs"]
    largest_return: Float[Array, "*batch"]
    reward: Float[Array, "*batch"]
    discount: Float[Array, "*batch"]

    @staticmethod
    def none(inputs: int) -> "Statistics":
        """Before the first step."""
        zeros = jnp.zeros(inputs)
        zero = jnp.zeros(())
        return Statistics(zero, zeros, zeros, zeros + jnp.inf, zeros - jnp.inf, zero, zero, zero)

    def with_steps(self, seen: Transition) -> "Statistics":
        """The measurements after more transitions ``[..., steps]``."""
        obs = seen.obs.reshape(-1, seen.obs.shape[-1])
        count, mean = jnp.asarray(len(obs), jnp.float32), obs.mean(0)
        total = self.count + count
        difference = mean - self.mean
        size = jnp.maximum(jnp.quantile(jnp.abs(discounted_returns(seen)), 0.99), jnp.abs(seen.reward).max())
        return Statistics(
            total,
            self.mean + difference * count / total,
            self.squares + jnp.sum((obs - mean) ** 2, axis=0) + difference**2 * self.count * count / total,
            jnp.minimum(self.low, obs.min(0)),
            jnp.maximum(self.high, obs.max(0)),
            jnp.maximum(self.largest_return, size),
            self.reward + (seen.reward.mean() - self.reward) * count / total,
            self.discount + (seen.discount.mean() - self.discount) * count / total,
        )

    @property
    def scaling(self) -> Scaling:
        """Observations of mean 0 and deviation 1, and returns of the order of ten.

        A component that never changes is only shifted. The range counts too, or what is rare in random
        steps, such as a flag, would be enormous whenever it is not.
        """
        deviation = jnp.sqrt(self.squares / jnp.maximum(self.count, 1))
        reach = jnp.maximum(self.high - self.mean, self.mean - self.low) / _FARTHEST
        deviation = jnp.maximum(deviation, reach)
        return Scaling(
            self.mean,
            jnp.where(deviation > _ROUNDING * jnp.maximum(jnp.abs(self.mean), 1), deviation, 1.0),
            jnp.where(self.largest_return > 0, self.largest_return / _ORDER_OF_Q, 1.0),
            self.level,
        )

    @property
    def level(self) -> Float[Array, ""]:
        """The value of random steps if all states were one: V̄ = R̄ + d̄·V̄.

        Q-learning that starts far from the level of the returns spends most of its updates on coming there.
        """
        return self.reward / jnp.maximum(1 - self.discount, _ROUNDING)


#: A spread below this share of the numbers themselves is rounding.
_ROUNDING = 1e-6


Rows = Float[Array, "*rows"]


def discounted_returns(seen: Transition) -> Float[Array, "*rows steps"]:
    """The discounted return from each step to the end of its episode, or of its row ``[..., steps]``."""
    steps_first = lambda leaf: jnp.moveaxis(leaf, seen.reward.ndim - 1, 0)  # noqa: E731
    goes_on = joined(seen)
    rows = jax.tree.map(steps_first, (seen.reward, seen.discount, goes_on))

    def one_step(following: Rows, row: tuple[Rows, Rows, Bool[Array, "*rows"]]) -> tuple[Rows, Rows]:
        reward, discount, goes_on = row
        value = reward + discount * jnp.where(goes_on, following, 0.0)
        return value, value

    _, returns = jax.lax.scan(one_step, jnp.zeros(seen.reward.shape[:-1]), rows, reverse=True)
    return jnp.moveaxis(returns, 0, -1)


def joined(seen: Transition) -> Bool[Array, "*rows steps"]:
    """Whether the successor of each step is what the next step begins with: not at an episode's end or the row's."""
    axes = tuple(range(seen.reward.ndim, seen.obs.ndim))
    steps = seen.reward.ndim - 1
    obs, next_obs = (jnp.moveaxis(leaf, steps, 0) for leaf in (seen.obs, seen.next_obs))
    same = jnp.all(obs[1:] == next_obs[:-1], axis=axes)
    return jnp.moveaxis(jnp.concatenate([same, jnp.zeros_like(same[:1])]), 0, -1)
