"""`PotentialShaping`: rewards shaped by a potential, for any Gymnasium environment and any learner."""

from typing import Any

import gymnasium as gym
from gymnasium.utils import RecordConstructorArgs
from gymnasium.wrappers import Autoreset

from upslope.equations.shaping import shaping_reward
from upslope.errors import UpslopeError
from upslope.wrappers.abstract_shaping import AbstractShaping, with_shaping_arguments
from upslope.wrappers.dispatch import SINGLE
from upslope.wrappers.evaluation import Evaluator, recordable
from upslope.wrappers.reporting import report, report_reset
from upslope.wrappers.terms import Count, Number, Terms


class PotentialShaping(AbstractShaping, gym.Wrapper, RecordConstructorArgs):
    """R' = R + F with F = γ·Φ(s') − Φ(s) (Def. 2.1), which leaves every optimal policy optimal (Thm. 2.1).

    - Terminated: Φ(s') counts as zero and is not evaluated, and −Φ(s) is still paid. Truncated: Φ(s') is kept.
      Both at once: terminated.
    - ``info`` holds ``raw_reward``, ``shaping_reward`` (F) and ``potential`` (Φ as it counted: zero at a terminal
      state). If an environment is wrapped twice, both shapings add up and ``raw_reward`` stays the environment's.
    - Order: environment, monitor (raw returns), this wrapper, then normalisation. Never clip or centre R + F. Evaluate
      without this wrapper, or with ``enabled`` set to False.

    Attributes:
        enabled: the switch. It takes effect at the next reset, so that F telescopes over every episode. Either setting
            keeps the optimal policies, but values learned under one differ from the other's by Φ.
    """

    @with_shaping_arguments
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
        """Wraps a single environment; `upslope.shape` finds the wrapper for other kinds."""
        SINGLE.check(env)
        self._evaluator = Evaluator(potential, env.observation_space)
        self._terms = Terms(self._evaluator.potential, gamma, scale, bias, anneal_steps, repeat)
        RecordConstructorArgs.__init__(self, potential=recordable(potential), enabled=enabled, **self._terms.settings)
        gym.Wrapper.__init__(self, env)
        self.enabled = enabled
        self._resets_itself = _contains(env, Autoreset)
        self._steps = 0
        self._active = enabled
        self._potential: float | None = None
        self._ended = False

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        obs, info = self.env.reset(seed=seed, options=options)
        return obs, report_reset(info, self._begin(obs))

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """One step with its reward shaped.

        Raises:
            UpslopeError: before the first reset, after the end of an episode, or where Φ fails or is not finite.
        """
        if self._potential is None:
            raise UpslopeError("step was called before reset: reset the environment first.")
        if self._ended and not self._resets_itself:
            raise UpslopeError("step was called after the episode had ended: reset the environment first.")
        obs, reward, terminated, truncated, info = self.env.step(action)
        reward, terminated, truncated = float(reward), bool(terminated), bool(truncated)
        if self._ended:  # the dummy step of Autoreset: a reset, not a transition
            potential, added = self._begin(obs), 0.0
        else:
            self._steps += 1
            potential = 0.0 if terminated else self._level(obs)
            added = shaping_reward(self._potential, self._terms.gamma, potential)
            self._potential = potential
            self._ended = terminated or truncated
        return obs, reward + added, terminated, truncated, report(info, reward, added, potential)

    def _begin(self, obs: Any) -> float:
        """A new episode: the switch takes effect, and Φ' of its first observation is remembered."""
        self._active = self.enabled
        self._ended = False
        self._potential = self._level(obs)
        return self._potential

    def _level(self, obs: Any) -> float:
        """Φ' of an observation, as the learner's reward sees it."""
        weight = self._terms.weight(self._steps) if self._active else 0.0
        return self._terms.level(self._evaluator.one(obs), weight) if weight else 0.0


def _contains(env: gym.Env, kind: type) -> bool:
    """Whether one of the wrappers of an environment is of a kind."""
    while isinstance(env, gym.Wrapper):
        if isinstance(env, kind):
            return True
        env = env.env
    return False
