"""How long Algorithm 2's second step should be compared with its first: a study on tuning tasks of both families."""

from dataclasses import asdict, dataclass, field, replace
from typing import Any, NamedTuple

from upslope.adaptation.algorithm2 import AdaptationConfig, Algorithm2, UpdateRule
from upslope.experiments.adaptation_panel import AdaptationPanel, adaptation_panel
from upslope.experiments.keys import Purpose, key_for
from upslope.experiments.maps.figures import full_grid_figure
from upslope.experiments.maps.priors import families
from upslope.experiments.priors import meta_train_priors
from upslope.experiments.results import EPISODE_LENGTH, SUCCESS, Panel, Score, provenance
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.recipes import for_grid_games
from upslope.run.compiling import compile_clock
from upslope.run.session import Session
from upslope.tasks import JaxTasks, cartpoles, grid_games


@dataclass(frozen=True)
class StepRatioConfig:
    """Settings of the study.

    Attributes:
        ratios: ratios of Eq. 9's step to Eq. 8's.
        seeds: the number of priors of each family.
        tasks: the number of tuning tasks for the step sizes, and of other tasks for the comparison. None of them is a
            test task of a figure: poles have other seeds, maps come from the training split.
        first_seed: the first seed; no figure uses these seeds.
        poles: Algorithm 1 on poles; it is stopped after a fifth of its iterations.
        maps: Algorithm 1 on maps; it is stopped half-way.
    """

    ratios: tuple[float, ...] = (1.0, 0.3, 0.1)
    seeds: int = 2
    tasks: int = 20
    first_seed: int = 10_000
    poles: MetaTrainingConfig = field(default_factory=MetaTrainingConfig)
    maps: MetaTrainingConfig = field(default_factory=lambda: for_grid_games(2400))


class _Setting(NamedTuple):
    """One family, with everything that adaptation on it needs."""

    training: JaxTasks
    adapting: JaxTasks
    meta_training: MetaTrainingConfig
    panel: AdaptationPanel
    adaptation: AdaptationConfig
    score: Score


def quick_step_ratio(config: StepRatioConfig) -> StepRatioConfig:
    """Few tasks and hardly trained priors: tests the code, and its results mean nothing."""
    poles, maps = replace(config.poles, iterations=50), replace(for_grid_games(16), evaluation_tasks=5)
    return replace(config, seeds=1, tasks=3, poles=poles, maps=maps)


def step_ratio(config: StepRatioConfig, session: Session | None = None) -> dict[str, Any]:
    """Adapts with every ratio at its own best step size, and returns the content of results.json."""
    rules: dict[str, UpdateRule] = {f"{ratio:g}": Algorithm2(value_step=ratio) for ratio in config.ratios}
    figure = full_grid_figure("obstacles")
    settings = {
        "poles": _Setting(
            cartpoles(),
            cartpoles(),
            config.poles,
            replace(AdaptationPanel(), stops=(config.poles.iterations // 5,)),
            AdaptationConfig(evaluation_episodes=1),
            EPISODE_LENGTH,
        ),
        "maps": _Setting(
            families("obstacles")[0],
            grid_games(split="train"),
            config.maps,
            replace(figure.panel, stops=(config.maps.iterations // 2,)),
            figure.adaptation,
            SUCCESS,
        ),
    }
    with compile_clock() as clock:
        rows = {name: _row(_compare(name, setting, config, rules, session)) for name, setting in settings.items()}
    return {
        "figure": "step-ratio",
        "variants": rows,
        **provenance(clock, asdict(config)),
    }


def _compare(
    name: str, setting: _Setting, config: StepRatioConfig, rules: dict[str, UpdateRule], session: Session | None
) -> Panel:
    seed = config.first_seed
    title = f"{name}: meta-training"
    priors = meta_train_priors(setting.training, setting.meta_training, seed, config.seeds, session, title)
    tasks = setting.adapting.sample_many(key_for(seed, Purpose.TEST_TASKS), config.tasks)
    return adaptation_panel(
        setting.adapting,
        priors,
        tasks,
        setting.panel,
        setting.adaptation,
        seed,
        session,
        rules={f"{name}, ratio {ratio}": rule for ratio, rule in rules.items()},
        score=setting.score,
    )


def _row(panel: Panel) -> dict[str, Any]:
    return {
        "arms": {name.rsplit(" ", 1)[-1]: arm.summary for name, arm in panel.arms.items()},
        "start": next(iter(panel.notes["zero_shot_on_tuning_tasks"].values())),
    }
