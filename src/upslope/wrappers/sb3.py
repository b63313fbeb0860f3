"""Shaping for Stable-Baselines3: a VecEnv wrapper, and a replay buffer for potentials that move.

Needs the extra ``upslope[sb3]``; nothing else here imports it.
"""

from typing import Any

import numpy as np

from upslope.errors import UpslopeError
from upslope.wrappers.evaluation import Evaluator
from upslope.wrappers.levels import Levels
from upslope.wrappers.terms import Terms

try:
    from stable_baselines3.common.buffers import ReplayBuffer
    from stable_baselines3.common.type_aliases import ReplayBufferSamples
    from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecNormalize
except ImportError as error:
    raise UpslopeError(
        f"Stable-Baselines3 can't be imported ({error}): install it with `pip install 'upslope[sb3]'`."
    ) from error


class PotentialShaping(VecEnvWrapper):
    """`upslope.PotentialShaping` for a VecEnv: VecMonitor goes inside it (raw returns), VecNormalize around it.

    A VecEnv resets in the same step: the true successor is ``infos[i]["terminal_observation"]``, and
    ``infos[i]["TimeLimit.truncated"]`` tells truncation from termination.

    Attributes:
        enabled: the switch; it takes effect at each environment's next reset.
    """

    def __init__(
        self,
        venv: VecEnv | Any,
        potential: Any,
        gamma: float,
        *,
        scale: float = 1.0,
        bias: float = 0.0,
        enabled: bool = True,
        anneal_steps: int | None = None,
    ):
        """Wraps a VecEnv; see `upslope.PotentialShaping` for the arguments.

        Args:
            venv: any VecEnv.
            potential: Φ.
            gamma: γ, the learner's own.
            scale: Φ is multiplied by it.
            bias: is added to Φ, in units of return.
            enabled: the switch.
            anneal_steps: the shaping's weight falls linearly to zero over so many steps of every environment.

        Raises:
            UpslopeError: no VecEnv, no potential, a prior for other observations or with another γ.
        """
        if not isinstance(venv, VecEnv):
            raise UpslopeError(
                f"{type(venv).__name__} is no VecEnv of Stable-Baselines3: for single environments there is "
                "upslope.PotentialShaping, and upslope.wrappers.vector for vectors of Gymnasium."
            )
        super().__init__(venv)
        self.enabled = enabled
        self._evaluator = Evaluator(potential, venv.observation_space)
        self._terms = Terms(self._evaluator.potential, gamma, scale, bias, anneal_steps)
        self._levels = Levels(self._evaluator, self._terms, np.full(venv.num_envs, enabled))
        self._potentials: np.ndarray | None = None

    @property
    def invariance(self) -> str:
        """What the settings keep of policy invariance, in a sentence."""
        return self._terms.invariance

    def reset(self) -> Any:
        obs = self.venv.reset()
        self._levels.active = np.full(self.num_envs, self.enabled)
        self._potentials = self._levels.weights * self._levels.of(obs, enabled=self.enabled)
        return obs

    def step_wait(self) -> Any:
        """One step of each, the rewards shaped.

        Raises:
            UpslopeError: before the first reset, a hidden terminal observation, or where Φ fails.
        """
        if self._potentials is None:
            raise UpslopeError("step was called before reset: reset the VecEnv first.")
        obs, rewards, dones, infos = self.venv.step_wait()
        self._levels.steps += 1
        levels = self._levels.of(obs, enabled=self.enabled)
        following = self._levels.weights * self._true_successors(levels, dones, infos)
        added = self._terms.gamma * following - self._potentials
        self._levels.active = np.where(dones, self.enabled, self._levels.active)
        self._potentials = self._levels.weights * levels
        infos = [_told(info, *row) for info, *row in zip(infos, rewards, added, following, strict=True)]
        return obs, (rewards + added).astype(rewards.dtype), dones, infos

    def _true_successors(self, levels: np.ndarray, dones: np.ndarray, infos: Any) -> np.ndarray:
        """Bias + scale·Φ where it counts: of the last observation where truncated, zero where terminated."""
        levels = levels.copy()
        for i in np.flatnonzero(dones):
            if "terminal_observation" not in infos[i]:
                raise UpslopeError(
                    "The VecEnv resets but hides the final observation: it must give it in "
                    'infos[i]["terminal_observation"], as those of Stable-Baselines3 do.'
                )
            truncated = infos[i].get("TimeLimit.truncated", False)
            value = (
                self._evaluator.one(infos[i]["terminal_observation"]) if truncated and self._levels.active[i] else 0.0
            )
            levels[i] = self._terms.bias + self._terms.scale * value if truncated else 0.0
        return levels


class ShapedReplayBuffer(ReplayBuffer):
    """Remembers raw rewards, and adds F when a batch is drawn, all of a batch with one version of Φ.

    For potentials that move, such as those of Algorithm 2: a buffer of shaped rewards would mix F of many versions,
    which is not policy-invariant. Give it to an off-policy learner of Stable-Baselines3 with an unshaped environment:
    ``DQN(..., replay_buffer_class=ShapedReplayBuffer, replay_buffer_kwargs={"potential": phi, "gamma": 0.98})``.

    Attributes:
        potential: Φ; assign another to move it.
    """

    def __init__(self, *arguments: Any, potential: Any, gamma: float, **settings: Any):
        """Takes what the buffer of Stable-Baselines3 takes, and Φ with the learner's γ.

        Raises:
            UpslopeError: no potential, a prior for other observations or with another γ.
        """
        super().__init__(*arguments, **settings)
        self._gamma = gamma
        self.potential = potential

    @property
    def potential(self) -> Any:
        return self._evaluator.potential

    @potential.setter
    def potential(self, potential: Any) -> None:
        evaluator = Evaluator(potential, self.observation_space)
        Terms(evaluator.potential, self._gamma, 1.0, 0.0, None)
        self._evaluator = evaluator

    def _get_samples(self, batch_inds: np.ndarray, env: VecNormalize | None = None) -> ReplayBufferSamples:
        if env is not None and (env.norm_obs or env.norm_reward):
            raise UpslopeError(
                "VecNormalize changes what the replay draws, so that F would not belong to it: "
                "use it with norm_obs=False and norm_reward=False, or shape with upslope.wrappers.sb3.PotentialShaping."
            )
        samples = super()._get_samples(batch_inds, env)
        both = np.concatenate([samples.observations.cpu().numpy(), samples.next_observations.cpu().numpy()])
        # In one call, so that Φ can't move in between.
        phi, ahead = np.split(self._evaluator.many(both, len(both)), 2)
        # Terminated steps have done = 1 here, and truncated ones 0: the very factor of the learner's bootstrap.
        discount = self._gamma * (1.0 - samples.dones.cpu().numpy()[:, 0])
        added = self.to_torch((discount * ahead - phi).astype(np.float32)[:, None])
        return samples._replace(rewards=samples.rewards + added)


def _told(info: dict[str, Any], reward: Any, added: Any, potential: Any) -> dict[str, Any]:
    told = {"raw_reward": float(reward), "shaping_reward": float(added), "potential": float(potential)}
    if "shaping_reward" in info:  # a shaping inside this one: the two add up
        told = {
            "raw_reward": info["raw_reward"],
            "shaping_reward": told["shaping_reward"] + info["shaping_reward"],
            "potential": told["potential"] + info["potential"],
        }
    return {**info, **told}
