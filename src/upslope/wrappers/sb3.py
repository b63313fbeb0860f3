"""Shaping for Stable-Baselines3: a VecEnv wrapper, and a replay buffer for potentials that change during training.

Needs the extra ``upslope[sb3]``; no other module of upslope imports it.
"""

from typing import Any

import numpy as np

from upslope.equations.shaping import shaping_reward
from upslope.errors import UpslopeError
from upslope.rollouts.workers import call_or_end, close_or_end
from upslope.wrappers.abstract_shaping import AbstractShaping, with_shaping_arguments
from upslope.wrappers.batch_shaping import BatchShaping
from upslope.wrappers.dispatch import VEC_ENV
from upslope.wrappers.evaluation import Evaluator
from upslope.wrappers.reporting import report
from upslope.wrappers.terms import Count, Number, Terms

try:
    from stable_baselines3.common.buffers import ReplayBuffer
    from stable_baselines3.common.type_aliases import ReplayBufferSamples
    from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecNormalize
except ImportError as error:
    raise UpslopeError(
        f"Stable-Baselines3 can't be imported ({error}): install it with `pip install 'upslope[sb3]'`."
    ) from error


class PotentialShaping(AbstractShaping, VecEnvWrapper):
    """R' = R + F for a VecEnv, as `upslope.PotentialShaping` does for one environment.

    VecMonitor belongs inside it (raw returns), VecNormalize around it. A VecEnv resets in the same step: the true
    successor is ``infos[i]["terminal_observation"]``, and ``infos[i]["TimeLimit.truncated"]`` marks truncation.

    Attributes:
        enabled: the switch; it takes effect at each environment's next reset.
    """

    @with_shaping_arguments
    def __init__(
        self,
        env: VecEnv | Any,
        potential: Any,
        gamma: Number,
        *,
        scale: Number = 1.0,
        bias: Number = 0.0,
        enabled: bool = True,
        anneal_steps: Count | None = None,
        repeat: Count = 1,
    ):
        """Wraps a VecEnv; `upslope.shape` finds the wrapper for other kinds."""
        VEC_ENV.check(env)
        VecEnvWrapper.__init__(self, env)
        self.enabled = enabled
        evaluator = Evaluator(potential, env.observation_space)
        self._terms = Terms(evaluator.potential, gamma, scale, bias, anneal_steps, repeat)
        self._shaping = BatchShaping(evaluator, self._terms, np.full(self.num_envs, enabled))

    def reset(self) -> Any:
        obs = call_or_end(self.venv, self.venv.reset)
        self._shaping.reset(obs, np.ones(self.num_envs, bool), self.enabled)
        return obs

    def step_async(self, actions: np.ndarray) -> None:
        call_or_end(self.venv, self.venv.step_async, actions)

    def step_wait(self) -> Any:
        """One step of each, with the rewards shaped.

        Raises:
            UpslopeError: before the first reset, if a terminal observation is hidden, if an observation has another
                shape than its space, if a worker died (the others are then ended too), or where Φ fails.
        """
        self._shaping.check_begun()
        obs, rewards, dones, infos = call_or_end(self.venv, self.venv.step_wait)
        finals = [info.get("terminal_observation") for info in infos]
        truncated = np.array([bool(info.get("TimeLimit.truncated")) for info in infos])
        added, potentials = self._shaping.step_with_resets(obs, dones, dones & ~truncated, finals, self.enabled)
        values = zip(rewards.tolist(), added.tolist(), potentials.tolist(), strict=True)
        infos = [report(info, *row) for info, row in zip(infos, values, strict=True)]
        return obs, (rewards + added).astype(rewards.dtype), dones, infos

    def close(self) -> None:
        """Closes the environments; if a worker has died, ends the others."""
        close_or_end(self.venv, self.venv.close)


class ShapedReplayBuffer(ReplayBuffer):
    """Stores raw rewards, and adds F when a batch is drawn: one version of Φ shapes the whole batch.

    For potentials that change during training, such as those of Algorithm 2: a buffer of shaped rewards would mix F of
    many versions, which is not policy-invariant. Use it in an off-policy learner with an unshaped environment:
    ``DQN(..., replay_buffer_class=ShapedReplayBuffer, replay_buffer_kwargs={"potential": phi, "gamma": 0.98})``.

    - One γ: the learner bootstraps with the buffer's γ, which comes with every batch, and not with its own. Give both
      the same, so that the learner reports the γ that it learns with.
    - One step: the buffer refuses ``n_steps`` above 1. It does not see the ``n_steps`` of the learner itself:
      Stable-Baselines3 warns that it ignores it, and learns from one step.
    - There is no scale, bias or annealing: put them into Φ, which may change.

    Attributes:
        potential: Φ; assign another to change it.
    """

    def __init__(
        self, *arguments: Any, potential: Any, gamma: Number, repeat: Count = 1, n_steps: int = 1, **settings: Any
    ):
        """Takes what the buffer of Stable-Baselines3 takes, and Φ with the learner's γ.

        Args:
            arguments: as for the buffer of Stable-Baselines3.
            potential: Φ, as for `PotentialShaping`.
            gamma: γ of one step.
            repeat: number of times that a step repeats its action.
            n_steps: only 1.
            settings: as for the buffer of Stable-Baselines3.

        Raises:
            UpslopeError: the potential is not a potential, the prior was trained for other observations or another γ,
                or ``n_steps`` is above 1.
        """
        if n_steps != 1:
            raise UpslopeError(
                f"n_steps is {n_steps}, but ShapedReplayBuffer gives returns of one step: leave it out, or shape with "
                "upslope.wrappers.sb3.PotentialShaping and the learner's own buffer."
            )
        super().__init__(*arguments, **settings)
        self._gamma, self._repeat = gamma, repeat
        self.potential = potential

    @property
    def potential(self) -> Any:
        return self._evaluator.potential

    @potential.setter
    def potential(self, potential: Any) -> None:
        evaluator = Evaluator(potential, self.observation_space)
        self._terms = Terms(evaluator.potential, self._gamma, repeat=self._repeat)
        self._evaluator = evaluator

    def _get_samples(self, batch_inds: np.ndarray, env: VecNormalize | None = None) -> ReplayBufferSamples:
        if env is not None and (env.norm_obs or env.norm_reward):
            raise UpslopeError(
                "VecNormalize changes what the replay draws, so that F would not fit: "
                "use it with norm_obs=False and norm_reward=False, or shape with upslope.wrappers.sb3.PotentialShaping."
            )
        samples = super()._get_samples(batch_inds, env)
        both = np.concatenate([samples.observations.cpu().numpy(), samples.next_observations.cpu().numpy()])
        # The replay keeps discrete observations as vectors of one number.
        both = both.reshape((len(both), *(self.observation_space.shape or ())))
        # done is 1 where a step terminated and 0 where it was truncated: the learner's bootstrap has the same factor.
        continues = samples.dones.cpu().numpy()[:, 0] == 0
        # In one call, so that Φ can't change in between; Φ need not be defined at terminal states.
        phi, ahead = np.split(self._evaluator.where(both, np.append(np.ones_like(continues), continues)), 2)
        added = self.to_torch(shaping_reward(phi, self._terms.gamma, ahead).astype(np.float32)[:, None])
        discounts = samples.rewards.new_full(samples.rewards.shape, self._terms.gamma)
        return samples._replace(rewards=samples.rewards + added, discounts=discounts)
