"""`PotentialShaping`: rewards shaped by a potential, for any Gymnasium environment and any learner."""

from typing import Any

import gymnasium as gym
from gymnasium.utils import RecordConstructorArgs
from gymnasium.wrappers import Autoreset

from upslope.errors import UpslopeError
from upslope.wrappers.evaluation import Evaluator, recordable
from upslope.wrappers.terms import Count, Number, Terms


class PotentialShaping(gym.Wrapper, RecordConstructorArgs):
    """R' = R + F with F = γ·Φ(s') − Φ(s) (Def. 2.1), which leaves every optimal policy optimal (Thm. 2.1).

    - Terminated: Φ(s') counts as zero without being asked for, and −Φ(s) is still paid. Truncated: Φ(s') is kept.
      Both at once: terminated.
    - ``info`` holds ``raw_reward``, ``shaping_reward`` (F) and ``potential`` (Φ as it counted: zero at a terminal
      state). Wrapped twice, both shapings add up and ``raw_reward`` stays the environment's.
    - Order: environment, monitor (raw returns), this wrapper, then normalisation. Never clip or centre R + F. Evaluate
      without it, or with ``enabled`` set to False.

    Attributes:
        enabled: the switch. It takes effect at the next reset, so that F telescopes over every episode. Each setting
            keeps the optimal policies; values that were learned with the other one are off by Φ.
        invariance: what the settings keep of policy invariance, in a sentence.
    """

    def __init__(
        self,
        env: gym.Env | Any,
        potential: Any,
        gamma: Number,
        *,
        scale: Number = 1.0,
        bias: Number = 0.0,
        enabled: bool = True,
        anneal_steps: Count | None = None,
        repeat: Count = 1,
    ):
        """Wraps one environment.

        Args:
            env: any environment; for vector environments see `upslope.wrappers.vector.PotentialShaping`.
            potential: Φ: a prior, the path of a saved one, or a function of one observation (numpy, JAX or torch;
                with a leading batch axis if it needs one). It must not change: potentials that move are for
                shaping where batches are drawn.
            gamma: γ of one step, the learner's own. With k repeated actions per step it is γ of one action to the
                power of k.
            scale: Φ is multiplied by it.
            bias: is added to Φ, in units of return.
            enabled: the switch.
            anneal_steps: the shaping's weight falls linearly to zero over so many steps.
            repeat: how often a step repeats its action (frame-skip); ``gamma`` is checked against the prior's to the
                power of it, and nothing else depends on it.

        Raises:
            UpslopeError: no single environment, no potential, a prior for other observations or with another γ.
        """
        RecordConstructorArgs.__init__(
            self,
            potential=recordable(potential),
            gamma=gamma,
            scale=scale,
            bias=bias,
            enabled=enabled,
            anneal_steps=anneal_steps,
            repeat=repeat,
        )
        if not isinstance(env, gym.Env):
            raise UpslopeError(
                f"{type(env).__name__} is no single Gymnasium environment: for vector environments there is "
                "upslope.wrappers.vector.PotentialShaping, and upslope.wrappers.sb3 for those of Stable-Baselines3."
            )
        gym.Wrapper.__init__(self, env)
        self.enabled = enabled
        self._evaluator = Evaluator(potential, env.observation_space)
        self._terms = Terms(self._evaluator.potential, gamma, scale, bias, anneal_steps, repeat)
        self._resets_itself = _holds(env, Autoreset)
        self._steps = 0
        self._active = enabled
        self._potential: float | None = None
        self._ended = False

    @property
    def gamma(self) -> float:
        """γ that F is computed with; the learner must use the same."""
        return self._terms.gamma

    @property
    def invariance(self) -> str:
        return self._terms.invariance

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        obs, info = self.env.reset(seed=seed, options=options)
        inside = info["potential"] if "shaping_reward" in info else 0.0
        return obs, {**info, "shaping_reward": 0.0, "potential": self._begin(obs) + inside}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """One step, its reward shaped.

        Raises:
            UpslopeError: before the first reset, after an episode's end, or where Φ fails or is not finite.
        """
        if self._potential is None:
            raise UpslopeError("step was called before reset: reset the environment first.")
        if self._ended and not self._resets_itself:
            raise UpslopeError("step was called after the episode had ended: reset the environment first.")
        obs, reward, terminated, truncated, info = self.env.step(action)
        reward = float(reward)
        if self._ended:  # Autoreset's dummy step: a reset, not a transition
            following, added = self._begin(obs), 0.0
        else:
            self._steps += 1
            following = 0.0 if terminated else self._counted(obs)
            added = self._terms.gamma * following - self._potential
            self._potential = following
            self._ended = bool(terminated or truncated)
        told = {"raw_reward": reward, "shaping_reward": added, "potential": following}
        if "shaping_reward" in info:  # a shaping inside this one: the two add up
            told = {
                "raw_reward": info.get("raw_reward", reward),
                "shaping_reward": added + info["shaping_reward"],
                "potential": following + info["potential"],
            }
        return obs, reward + added, bool(terminated), bool(truncated), {**info, **told}

    def _begin(self, obs: Any) -> float:
        """A new episode: the switch takes effect, and Φ is armed."""
        self._active = self.enabled
        self._ended = False
        self._potential = self._counted(obs)
        return self._potential

    def _counted(self, obs: Any) -> float:
        weight = self._terms.weight(self._steps) if self._active else 0.0
        return weight * (self._terms.bias + self._terms.scale * self._evaluator.one(obs)) if weight else 0.0


def _holds(env: gym.Env, kind: type) -> bool:
    """Whether one of the wrappers around an environment is of a kind."""
    while isinstance(env, gym.Wrapper):
        if isinstance(env, kind):
            return True
        env = env.env
    return False
