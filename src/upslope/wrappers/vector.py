"""`PotentialShaping` for vector environments of Gymnasium, in all three autoreset modes."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode

from upslope.errors import UpslopeError
from upslope.rollouts.workers import call_or_end, close_or_end
from upslope.wrappers.abstract_shaping import AbstractShaping, with_shaping_arguments
from upslope.wrappers.batch_shaping import BatchShaping
from upslope.wrappers.dispatch import VECTOR
from upslope.wrappers.evaluation import Evaluator, recordable
from upslope.wrappers.reporting import report_batch, report_batch_reset
from upslope.wrappers.terms import Count, Number, Terms


class PotentialShaping(AbstractShaping, gym.vector.VectorWrapper, RecordConstructorArgs):
    """R' = R + F for every sub-environment, as `upslope.PotentialShaping` does for one environment.

    The true successor of a step is the observation returned, except under `AutoresetMode.SAME_STEP`: there it is
    ``infos["final_obs"]``. The step that resets under `AutoresetMode.NEXT_STEP` is not a transition: F is 0 there.

    Attributes:
        enabled: the switch; it takes effect at each sub-environment's next reset.
    """

    @with_shaping_arguments
    def __init__(
        self,
        env: gym.vector.VectorEnv | Any,
        potential: Any,
        gamma: Number,
        *,
        scale: Number = 1.0,
        bias: Number = 0.0,
        enabled: bool = True,
        anneal_steps: Count | None = None,
        repeat: Count = 1,
    ):
        """Wraps a vector environment; `upslope.shape` finds the wrapper for other kinds."""
        VECTOR.check(env)
        self._mode = autoreset_mode(env)
        evaluator = Evaluator(potential, env.single_observation_space)
        self._terms = Terms(evaluator.potential, gamma, scale, bias, anneal_steps, repeat)
        RecordConstructorArgs.__init__(self, potential=recordable(potential), enabled=enabled, **self._terms.settings)
        gym.vector.VectorWrapper.__init__(self, env)
        self.enabled = enabled
        self._shaping = BatchShaping(evaluator, self._terms, np.full(self.num_envs, enabled))
        self._ended = np.zeros(self.num_envs, bool)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Resets all sub-environments, or those of ``options["reset_mask"]``."""
        # The mask is copied: Gymnasium takes it out of the options.
        begins = np.array((options or {}).get("reset_mask", np.ones(self.num_envs, bool)))
        obs, infos = call_or_end(self.env, lambda: self.env.reset(seed=seed, options=options))
        potentials = self._shaping.reset(obs, begins, self.enabled)
        self._ended = self._ended & ~begins
        return obs, report_batch_reset(infos, potentials)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """One step of each, with the rewards shaped.

        Raises:
            UpslopeError: before the first reset, if a final observation is hidden, if an observation has another
                shape than its space, if a worker died (the others are then ended too), or where Φ fails.
        """
        self._shaping.check_begun()
        obs, rewards, terminated, truncated, infos = call_or_end(self.env, self.env.step, actions)
        rewards, is_terminal = np.asarray(rewards, np.float64), np.asarray(terminated, bool)
        done = np.logical_or(terminated, truncated)
        if self._mode is AutoresetMode.SAME_STEP:
            finals = infos.get("final_obs")
            finals = [None] * self.num_envs if finals is None else finals
            added, potentials = self._shaping.step_with_resets(obs, done, is_terminal, finals, self.enabled)
        else:
            begins = self._ended & (self._mode is AutoresetMode.NEXT_STEP)
            added, potentials = self._shaping.step(obs, is_terminal, begins, self.enabled)
        self._ended = done
        return obs, rewards + added, terminated, truncated, report_batch(infos, rewards, added, potentials)

    def close(self, **settings: Any) -> None:
        """Closes the environments; if a worker has died, ends the others."""
        close_or_end(self.env, lambda: self.env.close(**settings))


def autoreset_mode(env: gym.vector.VectorEnv) -> AutoresetMode:
    """When a vector environment resets its sub-environments.

    Raises:
        UpslopeError: it does not say.
    """
    mode = env.metadata.get("autoreset_mode")
    try:
        return AutoresetMode(mode)
    except ValueError as error:
        raise UpslopeError(
            f"The vector environment does not say how it resets (metadata['autoreset_mode'] is {mode!r}): "
            "set it to one of gymnasium.vector.AutoresetMode."
        ) from error
