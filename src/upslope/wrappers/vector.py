"""The vector twin of `upslope.wrappers.PotentialShaping`, under all three autoreset modes."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode
from jaxtyping import Bool, Float

from upslope.errors import UpslopeError
from upslope.rollouts.workers import call_or_end, close_or_end
from upslope.wrappers.evaluation import Evaluator, recordable
from upslope.wrappers.levels import Levels
from upslope.wrappers.terms import Count, Number, Terms


class PotentialShaping(gym.vector.VectorWrapper, RecordConstructorArgs):
    """R' = R + F for every sub-environment; the single wrapper's documentation holds here too.

    The true successor of a step is the observation returned, but for `AutoresetMode.SAME_STEP`: there it is
    ``infos["final_obs"]``. The dummy step that resets under `AutoresetMode.NEXT_STEP` is no transition: F is 0 there.

    Attributes:
        enabled: the switch; it takes effect at each sub-environment's next reset.
        invariance: what the settings keep of policy invariance, in a sentence.
    """

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
        """Wraps a vector environment; see the single wrapper for the arguments.

        Args:
            env: any vector environment that says how it resets in ``metadata["autoreset_mode"]``.
            potential: Φ.
            gamma: γ of one step, the learner's own.
            scale: Φ is multiplied by it.
            bias: is added to Φ, in units of return.
            enabled: the switch.
            anneal_steps: the shaping's weight falls linearly to zero over so many steps of every sub-environment.
            repeat: how often a step repeats its action.

        Raises:
            UpslopeError: no vector environment, an unknown autoreset mode, no potential, a prior for other
                observations or with another γ.
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
        if not isinstance(env, gym.vector.VectorEnv):
            raise UpslopeError(
                f"{type(env).__name__} is no Gymnasium vector environment: for single environments there is "
                "upslope.PotentialShaping, and upslope.wrappers.sb3 for those of Stable-Baselines3."
            )
        gym.vector.VectorWrapper.__init__(self, env)
        self._mode = _autoreset_mode(env)
        self.enabled = enabled
        evaluator = Evaluator(potential, env.single_observation_space)
        self._terms = Terms(evaluator.potential, gamma, scale, bias, anneal_steps, repeat)
        self._levels = Levels(evaluator, self._terms, np.full(self.num_envs, enabled))
        self._potentials: Float[np.ndarray, n] | None = None
        self._resetting = np.zeros(self.num_envs, bool)

    @property
    def gamma(self) -> float:
        """γ that F is computed with; the learner must use the same."""
        return self._terms.gamma

    @property
    def invariance(self) -> str:
        return self._terms.invariance

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Resets all sub-environments, or those of ``options["reset_mask"]``."""
        # The mask is copied: Gymnasium takes it out of the options.
        fresh = np.array((options or {}).get("reset_mask", np.ones(self.num_envs, bool)))
        obs, infos = call_or_end(self.env, lambda: self.env.reset(seed=seed, options=options))
        self._begin(fresh)
        previous = np.zeros(self.num_envs) if self._potentials is None else self._potentials
        self._potentials = np.where(fresh, self._levels.of(obs, fresh), previous)
        self._resetting = self._resetting & ~fresh
        none = np.zeros(self.num_envs)
        told = self._told(infos, none, none, self._potentials)
        return obs, {name: value for name, value in told.items() if not name.endswith("raw_reward")}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """One step of each, the rewards shaped.

        Raises:
            UpslopeError: before the first reset, a hidden final observation, one of another shape, a worker that died
                (the others are ended too), or where Φ fails.
        """
        if self._potentials is None:
            raise UpslopeError("step was called before reset: reset the vector environment first.")
        obs, rewards, terminated, truncated, infos = call_or_end(self.env, self.env.step, actions)
        rewards = np.asarray(rewards, np.float64)
        done = np.logical_or(terminated, truncated)
        starting = self._resetting if self._mode is AutoresetMode.NEXT_STEP else np.zeros_like(done)
        self._levels.steps += 1
        if self._mode is AutoresetMode.SAME_STEP:
            following, potentials = self._levels_around_resets(obs, np.asarray(terminated), done, infos)
        else:
            self._begin(starting)
            following = potentials = self._levels.of(obs, np.logical_not(terminated))
        added = np.where(starting, 0.0, self._terms.gamma * following - self._potentials)
        self._potentials = potentials
        self._resetting = done
        return obs, rewards + added, terminated, truncated, self._told(infos, rewards, added, following)

    def close(self, **settings: Any) -> None:
        """Closes the environments; where a worker has died, it ends the others."""
        close_or_end(self.env, lambda: self.env.close(**settings))

    def _begin(self, fresh: Bool[np.ndarray, "n"]) -> None:
        """New episodes in some of the sub-environments: the switch takes effect there."""
        self._levels.active = np.where(fresh, self.enabled, self._levels.active)

    def _levels_around_resets(
        self,
        obs: Any,
        terminated: Bool[np.ndarray, "n"],
        done: Bool[np.ndarray, "n"],
        infos: dict[str, Any],
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """The levels that count as those of the successors, and those of what is shown, some of it newly reset."""
        if not done.any():
            shown = self._levels.of(obs, ~done)
            return shown, shown
        finals = infos.get("final_obs")
        ended = np.flatnonzero(done & self._levels.active)
        if ended.size and (finals is None or any(finals[i] is None for i in ended)):
            raise UpslopeError(
                "The vector environment resets in the same step but hides the final observation: it must give it in "
                'infos["final_obs"], or use AutoresetMode.NEXT_STEP.'
            )
        last = self._levels.of_last(finals, done & ~terminated)
        self._begin(done)
        shown = self._levels.of(obs, np.ones_like(done))
        return np.where(done, last, shown), shown

    def _told(self, infos: dict[str, Any], rewards: np.ndarray, added: np.ndarray, counted: np.ndarray) -> dict:
        count = self.num_envs
        values = {
            "raw_reward": _from_inside(infos, "raw_reward", rewards, count),
            "shaping_reward": added + _from_inside(infos, "shaping_reward", 0.0, count),
            "potential": counted + _from_inside(infos, "potential", 0.0, count),
        }
        return infos | values | {f"_{name}": np.ones(count, bool) for name in values}


def _autoreset_mode(env: gym.vector.VectorEnv) -> AutoresetMode:
    mode = env.metadata.get("autoreset_mode")
    try:
        return AutoresetMode(mode)
    except ValueError as error:
        raise UpslopeError(
            f"The vector environment does not say how it resets (metadata['autoreset_mode'] is {mode!r}): "
            "set it to one of gymnasium.vector.AutoresetMode."
        ) from error


def _from_inside(infos: dict[str, Any], key: str, otherwise: Any, count: int) -> Float[np.ndarray, "n"]:
    """What a shaping inside reported, for each sub-environment: with a same-step reset it stands in final_info."""
    values = np.broadcast_to(np.asarray(otherwise, np.float64), (count,)).copy()
    for source in (infos, infos.get("final_info") or {}):
        if "shaping_reward" in source and key in source:
            there = source[f"_{key}"]
            values[there] = np.asarray(source[key], np.float64)[there]
    return values
