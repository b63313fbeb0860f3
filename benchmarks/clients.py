"""How many steps Stable-Baselines3's learners need on fresh poles: shaped, unshaped, and with a constant potential.

``python -m benchmarks.clients`` writes ``runs.jsonl``, ``results.json`` and ``figure.png`` into ``docs/data/clients``.
It takes most of an hour; a second start continues with the missing runs.
"""

import copy
import itertools
import json
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import stable_baselines3 as sb3
import torch
import tyro
from rich.progress import track
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.noise import NormalActionNoise

import upslope
from benchmarks.clients_report import ARMS, Run, write_report
from upslope.priors.pretrained import prior_path
from upslope.run.machine import hardware, versions

FOLDER = Path(__file__).parents[1] / "docs" / "data" / "clients"

TUNING_SEEDS = range(100, 104)

#: Environment steps of a run, and between its evaluations.
STEPS: dict[str, tuple[int, int]] = {"DQN": (4000, 100), "PPO": (20_000, 500), "SAC": (4000, 100), "TD3": (4000, 100)}

#: Stable-Baselines3's defaults but for sizes that suit a CartPole.
SMALL = {"buffer_size": 10_000, "learning_starts": 100}
DQN = SMALL | {"learning_rate": 1e-3, "batch_size": 64, "train_freq": 1, "policy_kwargs": {"net_arch": [32, 32]}}

SAC = SMALL | {"policy_kwargs": {"net_arch": [64, 64]}}
FAST = {"learning_rate": 1e-3, "tau": 0.01}

#: What was tried on tuning poles, with ``--tuning``.
VARIANTS: dict[str, dict[str, dict[str, Any]]] = {
    "DQN": {
        "target copied every 100 steps": DQN | {"target_update_interval": 100},
        "soft target": DQN | {"target_update_interval": 1, "tau": 0.01},
        "soft target, step size decayed": DQN | {"target_update_interval": 1, "tau": 0.01, "decays": True},
    },
    "SAC": {
        "defaults": SAC,
        "step size 1e-3, target rate 0.01": SAC | FAST,
        "the same, entropy's weight from 0.1": SAC | FAST | {"ent_coef": "auto_0.1"},
    },
    "TD3": {
        "noise 0.1": SAC | {"noise": 0.1},
        "noise 0.1, target rate 0.01": SAC | FAST | {"noise": 0.1},
        "noise 0.3, target rate 0.01": SAC | FAST | {"noise": 0.3},
    },
}

#: One setting for all arms: of each learner's variants the one with the highest return over all arms. PPO is untuned.
SETTINGS: dict[str, dict[str, Any]] = {
    "DQN": VARIANTS["DQN"]["soft target, step size decayed"],
    "PPO": {"n_steps": 256, "policy_kwargs": {"net_arch": [32, 32]}},
    "SAC": VARIANTS["SAC"]["step size 1e-3, target rate 0.01"],
    "TD3": VARIANTS["TD3"]["noise 0.3, target rate 0.01"],
}


@dataclass(frozen=True)
class Options:
    """What to run."""

    algorithms: tuple[str, ...] = ("DQN", "SAC", "TD3", "PPO")
    seeds: int = 10
    """Each with its own pole, whose length is drawn from U[0.25, 5] by the seed."""
    first_seed: int = 600
    episodes: int = 5
    """Greedy ones on the raw environment at every evaluation, from the same starts each time."""
    tuning: bool = False
    """Instead: the learners' variants on four poles of other seeds, written into ``tuning.jsonl``."""
    quick: bool = False
    """Two seeds and few steps, to see that all works."""
    out: Path = FOLDER


def main(options: Options) -> None:
    """Runs whatever is missing, seed by seed with all arms in turn, and writes the report."""
    torch.set_num_threads(1)
    options.out.mkdir(parents=True, exist_ok=True)
    if options.tuning:
        tune(options)
        return
    path = options.out / "runs.jsonl"
    done = {run.name: run for run in read(path)}
    wanted = [
        (algorithm, seed, arm)
        for algorithm in options.algorithms
        for seed in range(options.first_seed, options.first_seed + (2 if options.quick else options.seeds))
        for arm in ARMS
    ]
    for algorithm, seed, arm in track(wanted, "runs"):
        if (algorithm, seed, arm) not in done:
            run = learn(algorithm, seed, arm, options, SETTINGS[algorithm])
            done[run.name] = run
            append(path, run)
    about = {
        "settings": {name: SETTINGS[name] for name in options.algorithms},
        "episodes": options.episodes,
        "versions": versions() | {"stable_baselines3": sb3.__version__, "torch": torch.__version__},
        "hardware": hardware(),
    }
    write_report([done[name] for name in wanted], about, options.out)


def tune(options: Options) -> None:
    """Mean returns of the learners' variants; all arms count, so that the choice favours none."""
    path = options.out / "tuning.jsonl"
    done = {(*run.name, run.variant) for run in read(path)}
    for algorithm, seed in itertools.product(options.algorithms, TUNING_SEEDS):
        for variant, settings in VARIANTS.get(algorithm, {}).items():
            for arm in ARMS:
                if (algorithm, seed, arm, variant) in done:
                    continue
                run = learn(algorithm, seed, arm, replace(options, quick=False), settings, variant)
                append(path, run)
                print(algorithm, variant, arm, f"{run.length:.2f} m", f"{np.mean(run.returns):.0f}", flush=True)


def append(path: Path, run: Run) -> None:
    """Adds a run to a file."""
    with path.open("a", encoding="utf-8") as lines:
        lines.write(json.dumps(asdict(run)) + "\n")


def read(path: Path) -> list[Run]:
    """The runs of a file; a last line that was cut off is left out."""
    if not path.exists():
        return []
    whole = path.read_text(encoding="utf-8").rpartition("\n")[0]
    path.write_text(whole + "\n" * bool(whole), encoding="utf-8")
    return [Run(**json.loads(line)) for line in whole.splitlines()]


def learn(algorithm: str, seed: int, arm: str, options: Options, settings: dict[str, Any], variant: str = "") -> Run:
    """One learner on one pole; its mean raw greedy return before any learning, and at every evaluation."""
    name = "upslope/CartPole-v0" if algorithm in ("DQN", "PPO") else "upslope/ContinuousCartPole-v0"
    length = float(np.random.default_rng(seed).uniform(0.25, 5.0))
    prior = upslope.load_prior("cartpole")
    env: gym.Env = Monitor(gym.make(name, length=length))
    if arm != "unshaped":
        # The control: the effect of the prior's mean level alone, which is on its card.
        level = json.loads(prior_path("cartpole").with_suffix(".json").read_text(encoding="utf-8"))["level"]
        env = upslope.PotentialShaping(env, prior if arm == "shaped" else lambda obs: level, gamma=prior.gamma)
    steps, every = (600, 200) if options.quick else STEPS[algorithm]
    began = time.perf_counter()
    learner = getattr(sb3, algorithm)
    actions: Any = env.action_space
    model = learner("MlpPolicy", env, gamma=prior.gamma, seed=seed, device="cpu", **for_sb3(settings, actions.shape))
    evaluation = GreedyReturns(gym.make_vec(name, options.episodes, length=length), every, seed)
    model.learn(steps, callback=evaluation)
    curve = evaluation.returns[: steps // every + 1]  # PPO continues to the end of its last rollout
    return Run(algorithm, seed, arm, length, every, curve, round(time.perf_counter() - began, 1), variant)


def for_sb3(settings: dict[str, Any], actions: tuple[int, ...]) -> dict[str, Any]:
    """The settings, with objects for a step size that falls linearly to zero and for the noise of actions."""
    given = copy.deepcopy(settings)  # learners add to the dicts that they are given
    if given.pop("decays", False):
        size = given["learning_rate"]
        given["learning_rate"] = lambda left: left * size
    if "noise" in given:
        given["action_noise"] = NormalActionNoise(np.zeros(actions), np.full(actions, given.pop("noise")))
    return given


class GreedyReturns(BaseCallback):
    """The mean raw return of one greedy episode in each of several environments, at regular intervals.

    Attributes:
        returns: so far; the first before any learning.
    """

    def __init__(self, envs: gym.vector.VectorEnv, every: int, seed: int):
        """Takes raw environments, the steps between evaluations, and the seed of their starts."""
        super().__init__()
        self.returns: list[float] = []
        self._envs, self._every, self._seed = envs, every, seed

    def _on_training_start(self) -> None:
        self._evaluate()

    def _on_step(self) -> bool:
        if self.num_timesteps % self._every == 0:
            self._evaluate()
        return True

    def _evaluate(self) -> None:
        obs, _ = self._envs.reset(seed=1000 * self._seed)
        alive, total = np.ones(self._envs.num_envs, bool), np.zeros(self._envs.num_envs)
        while alive.any():
            actions, _ = self.model.predict(obs, deterministic=True)
            obs, rewards, terminated, truncated, _ = self._envs.step(actions)
            total += alive * rewards
            alive &= ~(terminated | truncated)
        self.returns.append(float(total.mean()))


if __name__ == "__main__":
    main(tyro.cli(Options))
