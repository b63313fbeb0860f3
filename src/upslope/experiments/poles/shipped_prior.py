"""The prior that ships for CartPoles: trained, selected on training tasks, measured on fresh tasks, with a card."""

from dataclasses import asdict, dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console

from upslope.experiments.experiment import Experiment, Plan
from upslope.experiments.keys import Purpose, key_for
from upslope.experiments.priors import describe_priors, mean_levels, meta_train_priors, zero_shot_returns
from upslope.experiments.results import provenance, write_json
from upslope.experiments.shaping_panel import shaping_arms, shaping_panel
from upslope.learners.dqn import DQNConfig
from upslope.meta_training.config import MetaTrainingConfig
from upslope.priors.prior import Prior, trained_on
from upslope.run.compiling import compile_clock
from upslope.run.session import Session
from upslope.storage import write_atomically
from upslope.tasks import cartpoles

ARMS = {"unshaped": "no shaping", "constant": "constant potential (control)", "prior": "**this prior**"}


@dataclass(frozen=True)
class ShippedPriorConfig:
    """How the prior is trained and measured.

    Attributes:
        seeds: the number of candidate priors, and of learners on each task.
        first_seed: the first seed; no figure shares its prior or its fresh tasks.
        zero_shot_tasks: fresh tasks for the prior's own greedy actions, five episodes on each.
        tasks: fresh tasks for shaped learners.
        updates: updates of each learner, a DQN as in Figure 1.
        every: updates between evaluations.
        meta_training: settings of Algorithm 1.
        dqn: settings of the learner.
    """

    seeds: int = 5
    first_seed: int = 9000
    zero_shot_tasks: int = 200
    tasks: int = 40
    updates: int = 1000
    every: int = 100
    meta_training: MetaTrainingConfig = field(default_factory=MetaTrainingConfig)
    dqn: DQNConfig = field(default_factory=DQNConfig)


def quick_shipped_prior(config: ShippedPriorConfig) -> ShippedPriorConfig:
    """The quick form, a few seconds: tests the code; its prior is not good enough to ship."""
    short = replace(config.meta_training, iterations=20, evaluation_tasks=5)
    return replace(config, seeds=2, zero_shot_tasks=10, tasks=4, updates=100, meta_training=short)


def shipped_prior(config: ShippedPriorConfig, session: Session | None = None) -> tuple[Prior, dict[str, Any]]:
    """Trains the priors, selects one without using a fresh task, and measures it.

    Returns:
        The selected prior, and the content of its results.json.
    """
    family, seed = cartpoles(), config.first_seed
    with compile_clock() as clock:
        priors = meta_train_priors(family, config.meta_training, seed, config.seeds, session)
        training_returns = [
            float(row[np.flatnonzero(priors.iterations == at)[0]])
            for row, at in zip(priors.returns, priors.chosen, strict=True)
        ]
        best = int(np.argmax(training_returns))
        tasks = family.sample_many(key_for(seed, Purpose.TEST_TASKS), config.zero_shot_tasks)
        returns = np.asarray(zero_shot_returns(family, priors.final, tasks, key_for(seed, Purpose.ZERO_SHOT)))
        rows = [
            row
            | {
                "zero_shot_worst": float(np.min(each)),
                "iteration": int(iteration),
                "return_on_training_tasks": on_training_tasks,
            }
            for row, each, iteration, on_training_tasks in zip(
                describe_priors(returns, seed), returns, priors.chosen, training_returns, strict=True
            )
        ]
        copies = jax.tree.map(lambda leaf: jnp.repeat(leaf[best : best + 1], config.seeds, axis=0), priors.final)
        levels = np.asarray(mean_levels(family, copies, key_for(seed, Purpose.LEVEL)))
        arms = shaping_arms(family, copies, levels, None, config.tasks)
        fresh = jax.tree.map(lambda leaf: leaf[: config.tasks], tasks)
        panel = shaping_panel(
            "Shaped DQN",
            family,
            fresh,
            {name: arms[name] for name in ARMS},
            config.dqn,
            seed,
            updates=config.updates,
            every=config.every,
            session=session,
        )
    network = jax.tree.map(lambda leaf: leaf[best], priors.final)
    measured = {name: value for name, value in rows[best].items() if name != "seed"}
    prior = Prior(network, trained_on(family, network, seed + best, asdict(config.meta_training) | measured))
    return prior, {
        "figure": "shipped prior",
        "chosen_seed": seed + best,
        "priors": rows,
        "level": float(levels[0]),
        "shaped_dqn": {name: arm.summary for name, arm in panel.arms.items()},
        **provenance(clock, asdict(config)),
    }


def card(prior: Prior, results: dict[str, Any]) -> str:
    """What a user should know about the prior, in Markdown; every number comes from the results."""
    about, config = prior.trained_on, results["configuration"]
    training = config["meta_training"]
    table = [
        f"| {'**' * chosen}{row['seed']}{'**' * chosen} | {row['iteration']} | {row['return_on_training_tasks']:.1f} | "
        f"{row['zero_shot_median']:.1f} | {row['zero_shot_mean']:.2f} | {row['zero_shot_lower_quartile']:.1f} | "
        f"{row['zero_shot_worst']:.1f} |"
        for row in results["priors"]
        for chosen in [row["seed"] == results["chosen_seed"]]
    ]
    learners = [
        f"| {words} | {arm['mean_over_evaluations']:.0f} | {_words(arm['first_median_195'])} | "
        f"{arm['median'][-1]:.0f} | {arm['q1'][-1]:.0f} |"
        for name, words in ARMS.items()
        for arm in [results["shaped_dqn"][name]]
    ]
    return "\n".join(
        [
            "# The prior for CartPoles",
            "",
            f'`upslope.load_prior("cartpole")`: the V head of a dueling network of {about.hidden[0]} and '
            f"{about.hidden[1]} hidden units ({about.activation}), as a potential; γ = {about.gamma}.",
            "",
            "- **Trained on** CartPoles with a pole of full length U[0.25, 5] m (0.1 kg per metre), failure beyond 15° "
            f"or 2.4 m, at most 200 steps: Algorithm 1, {training['iterations']} iterations × "
            f"{training['tasks']} tasks × {training['steps_per_task']} steps.",
            "- **For** observations of four numbers in Gymnasium's order (m, m/s, rad, rad/s), and any action space; "
            f"the learner must discount with γ = {about.gamma}.",
            f"- **Level** {results['level']:.1f} on average over the states that it visits; `scale` and `bias` of the "
            "wrappers change it.",
            "- **Not tried** with other limits, masses, forces or time steps.",
            f"- **Made by** `upslope reproduce shipped-prior` with upslope {results['versions']['upslope']}, jax "
            f"{results['versions']['jax']}; numbers: `cartpole.json` next to this card.",
            "- **Licence** MIT, like the package.",
            "",
            f"Its own greedy actions on {config['zero_shot_tasks']} fresh poles, five episodes each, before any "
            f"learning on them; the maximum return is 200. Of {config['seeds']} seeds, the first of the best on "
            f"{training['evaluation_tasks']} extra training tasks ships:",
            "",
            "| seed | iteration | on extra training tasks | median | mean | lower quartile | worst pole |",
            "|---|---|---|---|---|---|---|",
            *table,
            "",
            f"As a potential: DQN on {config['tasks']} of the fresh poles × {config['seeds']} seeds, "
            f"{config['updates']} updates, raw greedy returns every {config['every']}:",
            "",
            "| | mean over evaluations | updates until the median is 195 | median at the end | lower quartile |",
            "|---|---|---|---|---|",
            *learners,
            "",
        ]
    )


def _words(updates: int | None) -> str:
    return "never" if updates is None else str(updates)


def _run(plan: Plan[ShippedPriorConfig], session: Session) -> tuple[Prior, dict[str, Any]]:
    return shipped_prior(plan.settings, session)


def _write(shipped: tuple[Prior, dict[str, Any]], folder: Path) -> None:
    prior, results = shipped
    prior.save(folder / "cartpole.safetensors", overwrite=True)
    checksum = sha256((folder / "cartpole.safetensors").read_bytes()).hexdigest()
    write_json(folder / "cartpole.json", results | {"sha256": checksum})
    write_atomically(folder / "cartpole.md", card(prior, results).encode())


def _summarise(shipped: tuple[Prior, dict[str, Any]], folder: Path, console: Console) -> None:
    console.print(card(*shipped), highlight=False, soft_wrap=True)
    console.print(f"The prior, its card and its numbers are in [bold]{folder}[/bold].")


SHIPPED_PRIOR = Experiment(ShippedPriorConfig, quick_shipped_prior, _run, _write, _summarise)
