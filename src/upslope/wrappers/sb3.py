"""Shaping for Stable-Baselines3: a VecEnv wrapper, and a replay buffer for potentials that move.

Needs the extra ``upslope[sb3]``; nothing else here imports it.
"""

from typing import Any

import numpy as np

from upslope.errors import UpslopeError
from upslope.rollouts.workers import call_or_end, close_or_end
from upslope.wrappers.evaluation import Evaluator
from upslope.wrappers.levels import Levels
from upslope.wrappers.terms import Count, Number, Terms

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
        gamma: Number,
        *,
        scale: Number = 1.0,
        bias: Number = 0.0,
        enabled: bool = True,
        anneal_steps: Count | None = None,
        repeat: Count = 1,
    ):
        """Wraps a VecEnv; see `upslope.PotentialShaping` for the arguments.

        Args:
            venv: any VecEnv.
            potential: Φ.
            gamma: γ of one step, the learner's own.
            scale: Φ is multiplied by it.
            bias: is added to Φ, in units of return.
            enabled: the switch.
            anneal_steps: the shaping's weight falls linearly to zero over so many steps of every environment.
            repeat: how often a step repeats its action.

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
        evaluator = Evaluator(potential, venv.observation_space)
        self._terms = Terms(evaluator.potential, gamma, scale, bias, anneal_steps, repeat)
        self._levels = Levels(evaluator, self._terms, np.full(venv.num_envs, enabled))
        self._potentials: np.ndarray | None = None

    @property
    def gamma(self) -> float:
        """γ that F is computed with; the learner must use the same."""
        return self._terms.gamma

    @property
    def invariance(self) -> str:
        """What the settings keep of policy invariance, in a sentence."""
        return self._terms.invariance

    def reset(self) -> Any:
        obs = call_or_end(self.venv, self.venv.reset)
        self._levels.active = np.full(self.num_envs, self.enabled)
        self._potentials = self._levels.of(obs, np.ones(self.num_envs, bool))
        return obs

    def step_async(self, actions: np.ndarray) -> None:
        call_or_end(self.venv, self.venv.step_async, actions)

    def step_wait(self) -> Any:
        """One step of each, the rewards shaped.

        Raises:
            UpslopeError: before the first reset, a hidden terminal observation, one of another shape, a worker that
                died (the others are ended too), or where Φ fails.
        """
        if self._potentials is None:
            raise UpslopeError("step was called before reset: reset the VecEnv first.")
        obs, rewards, dones, infos = call_or_end(self.venv, self.venv.step_wait)
        self._levels.steps += 1
        last = self._levels_of_last(dones, infos)
        self._levels.active = np.where(dones, self.enabled, self._levels.active)
        potentials = self._levels.of(obs, np.ones_like(dones))
        following = np.where(dones, last, potentials)
        added = self._terms.gamma * following - self._potentials
        self._potentials = potentials
        infos = [_told(info, *row) for info, *row in zip(infos, rewards, added, following, strict=True)]
        return obs, (rewards + added).astype(rewards.dtype), dones, infos

    def close(self) -> None:
        """Closes the environments; where a worker has died, it ends the others."""
        close_or_end(self.venv, self.venv.close)

    def _levels_of_last(self, dones: np.ndarray, infos: Any) -> np.ndarray:
        """The levels of the last observations where episodes were truncated; zero where they terminated."""
        for i in np.flatnonzero(dones & self._levels.active):
            if "terminal_observation" not in infos[i]:
                raise UpslopeError(
                    "The VecEnv resets but hides the final observation: it must give it in "
                    'infos[i]["terminal_observation"], as those of Stable-Baselines3 do.'
                )
        truncated = [bool(done and info.get("TimeLimit.truncated")) for done, info in zip(dones, infos, strict=True)]
        return self._levels.of_last([info.get("terminal_observation") for info in infos], np.array(truncated))


class ShapedReplayBuffer(ReplayBuffer):
    """Remembers raw rewards, and adds F when a batch is drawn, all of a batch with one version of Φ.

    For potentials that move, such as those of Algorithm 2: a buffer of shaped rewards would mix F of many versions,
    which is not policy-invariant. Give it to an off-policy learner of Stable-Baselines3 with an unshaped environment:
    ``DQN(..., replay_buffer_class=ShapedReplayBuffer, replay_buffer_kwargs={"potential": phi, "gamma": 0.98})``.

    - One γ: the learner bootstraps with the buffer's, which comes with every batch; its own is not used. Give both
      the same, so that the learner reports the one that it learns with.
    - One step: ``n_steps`` above 1 is refused here. What is given to the learner itself can't be seen from here:
      Stable-Baselines3 warns that it ignores it, and learns from one step.
    - There is no scale, bias or annealing: put them into Φ, which may move.

    Attributes:
        potential: Φ; assign another to move it.
    """

    def __init__(
        self, *arguments: Any, potential: Any, gamma: Number, repeat: Count = 1, n_steps: int = 1, **settings: Any
    ):
        """Takes what the buffer of Stable-Baselines3 takes, and Φ with the learner's γ.

        Args:
            arguments: as for the buffer of Stable-Baselines3.
            potential: Φ, as for `PotentialShaping`.
            gamma: γ of one step.
            repeat: how often a step repeats its action.
            n_steps: only 1.
            settings: as for the buffer of Stable-Baselines3.

        Raises:
            UpslopeError: no potential, a prior for other observations or with another γ, or returns of many steps.
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
                "VecNormalize changes what the replay draws, so that F would not belong to it: "
                "use it with norm_obs=False and norm_reward=False, or shape with upslope.wrappers.sb3.PotentialShaping."
            )
        samples = super()._get_samples(batch_inds, env)
        both = np.concatenate([samples.observations.cpu().numpy(), samples.next_observations.cpu().numpy()])
        # The replay keeps discrete observations as vectors of one number.
        both = both.reshape((len(both), *(self.observation_space.shape or ())))
        # Terminated steps have done = 1 here, and truncated ones 0: the very factor of the learner's bootstrap.
        goes_on = samples.dones.cpu().numpy()[:, 0] == 0
        # In one call, so that Φ can't move in between; Φ need not be defined at terminal states.
        phi, ahead = np.split(self._evaluator.where(both, np.append(np.ones_like(goes_on), goes_on)), 2)
        added = self.to_torch((self._terms.gamma * ahead - phi).astype(np.float32)[:, None])
        discounts = samples.rewards.new_full(samples.rewards.shape, self._terms.gamma)
        return samples._replace(rewards=samples.rewards + added, discounts=discounts)


def _told(info: dict[str, Any], reward: Any, added: Any, potential: Any) -> dict[str, Any]:
    told = {"raw_reward": float(reward), "shaping_reward": float(added), "potential": float(potential)}
    if "shaping_reward" in info:  # a shaping inside this one: the two add up
        told = {
            "raw_reward": info["raw_reward"],
            "shaping_reward": told["shaping_reward"] + info["shaping_reward"],
            "potential": told["potential"] + info["potential"],
        }
    return {**info, **told}
