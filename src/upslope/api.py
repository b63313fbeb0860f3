"""The verbs: meta-train a prior, evaluate it, adapt it to a task, train an agent with or without shaping."""

import math
import warnings
from dataclasses import asdict
from typing import Any

import jax
import jax.numpy as jnp

from upslope.adaptation import rules
from upslope.adaptation.algorithm2 import Adaptation, AdaptationConfig, Algorithm2, UpdateRule
from upslope.errors import PriorWarning, UpslopeError
from upslope.evaluation.first_look import look_at
from upslope.evaluation.learner_test import compare_learners
from upslope.evaluation.signs import signs
from upslope.evaluation.verdict import Verdict
from upslope.learners import AbstractLearnerConfig
from upslope.learners import suited_to as learner_suited_to
from upslope.learners.agent import Agent, record
from upslope.learners.curve import LearningCurve
from upslope.learners.learner import AbstractLearner
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.recipes import recipe_for
from upslope.priors.prior import Prior, trained_on
from upslope.priors.shaping_by import shaping_by
from upslope.results import AdaptationResult, TrainingResult
from upslope.run.loop import broadcast, run
from upslope.run.outcome import Outcome
from upslope.run.session import Session, with_progress
from upslope.tasks.family import AbstractFamily
from upslope.types import Key, Potential, Task


def meta_train(
    family: AbstractFamily,
    *,
    seed: int = 0,
    config: MetaTrainingConfig | None = None,
    session: Session | None = None,
    progress: bool | None = None,
) -> Prior:
    """Algorithm 1: learns a prior over a family of tasks.

    Args:
        family: the distribution of tasks p(T).
        seed: the seed of all random numbers.
        config: the settings; by default the recipe that suits the family.
        session: observers and checkpoints.
        progress: whether to show a progress bar; by default in a terminal or a notebook, unless the session has
            observers.

    Returns:
        The prior, with its learning curve in ``prior.curve``.

    Warns:
        PriorWarning: the prior shows signs of trouble on fresh training tasks: its policy is no better than random
            actions on all or some of them, or its potential is flat; or all tasks of the family are the same.

    Raises:
        UpslopeError: an argument has the wrong type, observations never change, observations or rewards are not finite,
            or training diverges.
    """
    _check_type("meta_train", "family", family, AbstractFamily)
    config = recipe_for(family) if config is None else config
    _check_type("meta_train", "config", config, MetaTrainingConfig)
    learner = MetaTraining(family, config)
    look_at(family, jax.random.key(seed))
    outcome = _run_one(learner, seed, config.iterations, config.snapshot_every, "meta-training", session, progress)
    prior = best_prior(family, outcome, config, 0, seed)
    for sentence in signs(family, prior.network, *_fresh_tasks(family, config.evaluation_tasks, seed)).warnings():
        warnings.warn(sentence, PriorWarning, stacklevel=2)
    return prior


def _fresh_tasks(family: AbstractFamily, count: int, seed: int) -> tuple[Task, Key]:
    """Stacked tasks ``[count, ...]`` that no training has drawn, and a key to evaluate with."""
    task_key, key = jax.random.split(jax.random.fold_in(jax.random.key(seed), _FRESH))
    return family.sample_many(task_key, count), key


#: Tells the keys of fresh tasks from those of training.
_FRESH = 0x5EED


def evaluate(
    prior: Prior,
    family: AbstractFamily,
    *,
    tasks: int = 20,
    learners: int = 10,
    updates: int = 2000,
    seed: int = 0,
    config: AbstractLearnerConfig | None = None,
    session: Session | None = None,
    progress: bool | None = None,
) -> Verdict:
    """A verdict on a prior: what its policy and its potential do on fresh tasks, and whether learners gain by it.

    Args:
        prior: θ.
        family: the family of the fresh tasks.
        tasks: the number of tasks on which policy and potential are measured.
        learners: the number of tasks on which learners are trained: unshaped, with a constant potential, and shaped.
            0 trains none, and the verdict is less certain.
        updates: of each learner.
        seed: the seed of tasks, experience and learners.
        config: the settings of the learners; by default those that suit the family and the number of updates.
        session: observers and checkpoints.
        progress: whether to show a progress bar; by default in a terminal or a notebook, unless the session has
            observers.

    Raises:
        UpslopeError: the prior is from another family, or has another γ, observation shape or number of actions; or the
            arguments have the wrong types or order.
    """
    _check_type("evaluate", "prior", prior, Prior)
    _check_type("evaluate", "family", family, AbstractFamily)
    prior.check(family, acting=True)
    if tasks < 1 or learners < 0 or updates < 1:
        raise UpslopeError(
            f"{tasks} tasks, {learners} learners and {updates} updates can't be run: give positive ones."
        )
    drawn, key = _fresh_tasks(family, max(tasks, learners), seed)
    signs_key, learner_key = jax.random.split(key)
    found = signs(family, prior.network, jax.tree.map(lambda leaf: leaf[:tasks], drawn), signs_key)
    if learners == 0:
        return Verdict(family.name, found, None)
    test = compare_learners(
        family,
        prior.network,
        found.level,
        jax.tree.map(lambda leaf: leaf[:learners], drawn),
        learner_key,
        learner_suited_to(family).lasting(updates) if config is None else config,
        updates=updates,
        every=max(updates // 10, 1),
        session=with_progress(session, progress),
    )
    return Verdict(family.name, found, test)


def best_prior(family: AbstractFamily, outcome: Outcome, config: MetaTrainingConfig, index: int, seed: int) -> Prior:
    """The best snapshot of one learner of a meta-training run, with its provenance and learning curve.

    Args:
        family: the family of the training.
        outcome: the outcome of the run.
        config: the settings of the training.
        index: the index of the learner in the run.
        seed: the learner's seed.
    """
    curve = _curve(outcome, index)
    best = config.best_snapshot(curve.returns)
    network = jax.tree.map(lambda leaf: jnp.asarray(leaf[index, best]), outcome.reports["prior"])
    measured = {"iteration": int(curve.updates[best]), "return_on_training_tasks": float(curve.returns[best])}
    return Prior(network, trained_on(family, network, seed, asdict(config) | measured), curve)


def train(
    family: AbstractFamily,
    task: Task,
    potential: Potential | Prior | None = None,
    *,
    updates: int = 1000,
    every: int = 100,
    seed: int = 0,
    config: AbstractLearnerConfig | None = None,
    session: Session | None = None,
    progress: bool | None = None,
) -> TrainingResult:
    """Trains an agent on one task: by default DQN on discrete actions, DDPG on continuous ones.

    Args:
        family: the family of the task.
        task: one task, unstacked.
        potential: Φ that shapes the rewards: a prior, or any function of one observation that JAX can trace;
            None for no shaping.
        updates: the number of gradient updates.
        every: the number of updates between reports of the raw greedy return.
        seed: the seed of the agent and its experience.
        config: the settings of the learner, which also choose the learner; by default those that suit the family and
            the number of updates.
        session: observers and checkpoints.
        progress: whether to show a progress bar; by default in a terminal or a notebook, unless the session has
            observers.

    Raises:
        UpslopeError: the prior does not belong to the tasks, the potential has the wrong shape or is not finite, or the
            learner is for another kind of action.
    """
    _check_type("train", "family", family, AbstractFamily)
    config = learner_suited_to(family).lasting(updates) if config is None else config
    _check_type("train", "config", config, AbstractLearnerConfig)
    learner = config.build(family, task, shaping_by(potential, family))
    outcome = _run_one(learner, seed, updates, every, config.name.upper(), session, progress)
    network = config.acting(_final_state(outcome))
    return TrainingResult(Agent(network, record(config, family, seed)), _curve(outcome, 0))


def adapt(
    family: AbstractFamily,
    task: Task,
    prior: Prior,
    *,
    updates: int = 20,
    step_size: float = 1e-3,
    rule: UpdateRule | None = None,
    seed: int = 0,
    config: AdaptationConfig | None = None,
    session: Session | None = None,
    progress: bool | None = None,
) -> AdaptationResult:
    """Algorithm 2: adapts a prior to one new task while learning to solve it.

    Args:
        family: the family of the task.
        task: one task, unstacked; for example ``family.sample(key)``.
        prior: θ.
        updates: the number of updates: pairs of steps by Eqs. 8 and 9.
        step_size: α.
        rule: the update rule, such as ``FineTuning()`` for MAML; Algorithm 2 by default.
        seed: the seed of the experience.
        config: the settings, such as batch size; by default those that suit the family.
        session: observers and checkpoints.
        progress: whether to show a progress bar; by default in a terminal or a notebook, unless the session has
            observers.

    Returns:
        The task-posterior and its learning curve, with a report before the first and after each update.

    Raises:
        UpslopeError: the prior is from another family, or has another γ, observation shape or number of actions; the
            step size is not positive; or the arguments have the wrong types or order.
    """
    _check_type("adapt", "family", family, AbstractFamily)
    _check_type("adapt", "prior", prior, Prior)
    config = rules.suited_to(family) if config is None else config
    _check_type("adapt", "config", config, AdaptationConfig)
    check_step_size(step_size)
    prior.check(family, acting=True)
    learner = Adaptation(family, task, prior.network, jnp.asarray(step_size), rule or Algorithm2(), config)
    outcome = _run_one(learner, seed, updates, 1, "adaptation", session, progress)
    return AdaptationResult(Prior(_final_state(outcome).phi, prior.trained_on), _curve(outcome, 0))


#: The order of each verb's arguments, for error messages.
_ORDERS = {
    "evaluate": "evaluate(prior, family)",
    "meta_train": "meta_train(family, config=...)",
    "train": "train(family, task, potential, config=...)",
    "adapt": "adapt(family, task, prior, config=...)",
}


def _check_type(verb: str, name: str, given: Any, needed: type) -> None:
    if not isinstance(given, needed):
        raise UpslopeError(
            f"The {name} of {verb} must be of the type {needed.__name__}, but {type(given).__name__} was given: "
            f"call {_ORDERS[verb]}."
        )


def check_step_size(step_size: float) -> None:
    """Checks that α is a valid step size.

    Raises:
        UpslopeError: it is not a positive number.
    """
    if not (math.isfinite(step_size) and step_size > 0):
        raise UpslopeError(f"The step size is {step_size}: give a positive number such as 0.001.")


def _run_one(
    learner: AbstractLearner,
    seed: int,
    updates: int,
    every: int,
    title: str,
    session: Session | None,
    progress: bool | None,
) -> Outcome:
    """Runs one learner, as a batch of one."""
    return run(
        broadcast(learner, (1,)),
        jax.random.key(seed)[None],
        updates=updates,
        every=every,
        title=title,
        session=with_progress(session, progress),
    )


def _final_state(outcome: Outcome) -> Any:
    """The final state of a batch of one learner.

    Raises:
        UpslopeError: the run had already finished, and its checkpoints do not contain the states.
    """
    if outcome.flat_states is None:
        raise UpslopeError(
            "This run was finished before, and its final state was not kept: "
            "give Checkpoints(..., final_states=True), and run it again in an empty folder."
        )
    return jax.tree.map(lambda leaf: leaf[0], outcome.states)


def _curve(outcome: Outcome, index: int) -> LearningCurve:
    """The learning curve of one of a run's learners."""
    metrics = {name: values[index] for name, values in outcome.metrics.items()}
    return LearningCurve(outcome.updates, outcome.reports["return"][index], metrics)
