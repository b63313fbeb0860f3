"""The verbs: meta-train a prior, adapt it to a task, train an agent with or without shaping."""

from dataclasses import asdict
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from upslope.adaptation import algorithm2 as adaptation
from upslope.adaptation.algorithm2 import Adaptation, AdaptationConfig, AdvantageHead, UpdateRule
from upslope.errors import UpslopeError
from upslope.learners import dqn
from upslope.learners.ddpg import DDPG, DDPGConfig
from upslope.learners.dqn import DQN, DQNConfig
from upslope.learners.shaping import Shaping, potential_based
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.recipes import suited_to
from upslope.priors.prior import Prior, trained_on
from upslope.run.loop import broadcast, run
from upslope.run.outcome import Outcome
from upslope.run.session import Session
from upslope.tasks.family import AbstractFamily
from upslope.types import Observation, Potential, Task


def meta_train(
    family: AbstractFamily,
    *,
    seed: int = 0,
    config: MetaTrainingConfig | None = None,
    session: Session | None = None,
) -> Prior:
    """Algorithm 1: learns a prior over a family of tasks, by the recipe that suits it where no settings are given.

    Raises:
        UpslopeError: training that diverges.
    """
    config = config or suited_to(family)
    keys = jax.random.key(seed)[None]
    outcome = run(
        broadcast(MetaTraining(family, config), (1,)),
        keys,
        updates=config.iterations,
        every=config.snapshot_every,
        title="meta-training",
        session=session,
    )
    return best_prior(family, outcome, config, 0, seed)


def best_prior(family: AbstractFamily, outcome: Outcome, config: MetaTrainingConfig, index: int, seed: int) -> Prior:
    """The best snapshot of one meta-training among several, with its provenance.

    Args:
        family: that it was trained on.
        outcome: of the run.
        config: of the training.
        index: which of the run's learners.
        seed: that it began with.
    """
    returns = outcome.reports["return"][index]
    best = config.best_snapshot(returns)
    network = jax.tree.map(lambda leaf: jnp.asarray(leaf[index, best]), outcome.reports["prior"])
    measured = {"iteration": int(outcome.updates[best]), "return_on_training_tasks": float(returns[best])}
    return Prior(network, trained_on(family, network, seed, asdict(config) | measured))


def adapt(
    prior: Prior,
    family: AbstractFamily,
    task: Task,
    *,
    updates: int = 20,
    step_size: float = 1e-3,
    rule: UpdateRule | None = None,
    seed: int = 0,
    config: AdaptationConfig | None = None,
    session: Session | None = None,
) -> tuple[Prior, np.ndarray]:
    """Algorithm 2: adapts a prior to one new task while learning to solve it.

    Args:
        prior: θ.
        family: of the task.
        task: one task, unstacked; for example ``family.sample(key)``.
        updates: pairs of Eqs. 8 and 9.
        step_size: α.
        rule: another arm, such as ``FineTuning()`` for MAML; Algorithm 2 by default.
        seed: of the experience.
        config: sizes of batches and replay.
        session: who watches, and where checkpoints go.

    Returns:
        The task-posterior, and the raw greedy return before the first and after each update ``[updates + 1]``.

    Raises:
        UpslopeError: a prior from another family, or with another γ, observation shape or number of actions.
    """
    prior.check(family, acting=True)
    learner = Adaptation(
        family,
        task,
        prior.network,
        jnp.asarray(step_size),
        rule or AdvantageHead(),
        config or (adaptation.for_maps() if _on_maps(family) else AdaptationConfig()),
    )
    outcome = run(
        broadcast(learner, (1,)),
        jax.random.key(seed)[None],
        updates=updates,
        every=1,
        title="adaptation",
        session=session,
    )
    network = jax.tree.map(lambda leaf: leaf[0], outcome.states.phi)
    return Prior(network, prior.trained_on), outcome.reports["return"][0]


def train(
    family: AbstractFamily,
    task: Task,
    potential: Potential | Prior | None = None,
    *,
    updates: int = 1000,
    every: int = 100,
    seed: int = 0,
    config: DQNConfig | DDPGConfig | None = None,
    session: Session | None = None,
) -> Outcome:
    """Trains an agent on one task: DQN on discrete actions, DDPG on continuous ones.

    Args:
        family: of the task.
        task: one task, unstacked.
        potential: Φ that shapes the rewards: a prior, or any function of one observation that JAX can trace;
            None for no shaping.
        updates: gradient updates.
        every: updates between reports of the raw greedy return.
        seed: of the agent and its experience.
        config: of the agent.
        session: who watches, and where checkpoints go.

    Raises:
        UpslopeError: a prior that does not belong to the tasks, or a potential of the wrong shape or not finite.
    """
    learner = agent(family, task, _shaping(family, potential), config)
    return run(
        broadcast(learner, (1,)),
        jax.random.key(seed)[None],
        updates=updates,
        every=every,
        title="DDPG" if family.actions.kind == "continuous" else "DQN",
        session=session,
    )


def agent(
    family: AbstractFamily, task: Task, shaping: Shaping | None, config: DQNConfig | DDPGConfig | None = None
) -> DQN | DDPG:
    """The learner for a family's kind of actions.

    Raises:
        UpslopeError: settings of the other kind of learner.
    """
    if family.actions.kind == "continuous":
        if isinstance(config, DQNConfig):
            raise UpslopeError("DQN needs discrete actions, but these tasks have continuous ones: use DDPG.")
        return DDPG(family, task, shaping, config or DDPGConfig())
    if isinstance(config, DDPGConfig):
        raise UpslopeError("DDPG needs continuous actions, but these tasks have discrete ones: use DQN.")
    return DQN(family, task, shaping, config or (dqn.for_maps() if _on_maps(family) else DQNConfig()))


def _on_maps(family: AbstractFamily) -> bool:
    """Whether observations are maps, for which networks are convolutional and learners have settings of their own."""
    return family.recipe in ("images", "maps")


def _shaping(family: AbstractFamily, potential: Potential | Prior | None) -> Shaping | None:
    if potential is None:
        return None
    if isinstance(potential, Prior):
        potential.check(family)
        return potential_based(potential.network.value)
    return potential_based(check_potential(potential, family))


def check_potential(potential: Potential, family: AbstractFamily) -> Any:
    """The potential as a traceable function, after a trial on one observation.

    Raises:
        UpslopeError: it returns something else than one finite number, or JAX can't trace it.
    """
    obs: Observation = jnp.zeros(family.observation_shape)
    try:
        shape = jax.eval_shape(potential, obs)
    except Exception as error:
        why, _, _ = str(error).partition("\n")  # tracers tell pages
        raise UpslopeError(
            f"The potential failed on one observation of shape {family.observation_shape} "
            f"({type(error).__name__}: {why}): write it with jax.numpy, for one observation."
        ) from error
    if getattr(shape, "shape", None) != ():
        raise UpslopeError(
            f"The potential returned {getattr(shape, 'shape', type(shape))} for one observation: "
            "return a single number."
        )
    if not bool(jnp.isfinite(potential(obs))):
        raise UpslopeError("The potential is not finite at the zero observation: make it finite everywhere.")
    return potential if isinstance(potential, eqx.Module) else jax.tree_util.Partial(potential)
