"""DQN learners, shaped or not, against Stable-Baselines3, SBX and a DQN in CleanRL's manner: speed and reached return.

``python -m benchmarks.shaping`` writes ``benchmarks/results/shaping.json``. The peers take part where they are
installed (``pip install stable-baselines3 sbx-rl torch==2.13.0``). A repeat is a stretch of one long run: six stretches
of 500 updates, the first of which compiles and is reported separately. Learners are
evaluated after 1,000 and after 3,000.
"""

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import gymnasium as gym
import jax
import jax.numpy as jnp
import numpy as np
import tyro

import upslope
from benchmarks import harness
from benchmarks.going import Going
from benchmarks.harness import Bar, Part, Row
from upslope.learners.dqn import DQN, DQNConfig
from upslope.learners.shaping import potential_based
from upslope.priors.prior import Prior
from upslope.run.compiling import set_up_devices
from upslope.run.loop import broadcast
from upslope.tasks import cartpoles

#: The pole of the middle of the family, for all.
LENGTH = 2.625
LAST = "return after the last"
CLEAN, SB3, SBX = "PyTorch, CleanRL's manner", "Stable-Baselines3", "SBX"


@dataclass(frozen=True)
class Options(harness.Options):
    """What to time.

    Attributes:
        counts: learners at once.
        updates: of each, all stretches together.
        early: updates after which learners are tried before the end too; they must end a stretch.
    """

    counts: tuple[int, ...] = (1, 10, 200, 1000)
    updates: int = 3000
    early: int = 1000


def main(options: Options) -> None:
    """Times stretches of all learners in turns, then tries them."""
    if options.quick:
        options = replace(options, counts=(1, 10), updates=60, early=20, repeats=2)
    set_up_devices(harness.scratch())
    prior = upslope.load_prior("cartpole")
    stretch = options.updates // (options.repeats + 1)
    learners: dict[str, Any] = {}
    for shaped in (False, True):
        how = "shaped" if shaped else "unshaped"
        learners |= {
            f"upslope, {harness.counted(n, 'learner')}, {how}": Ours(n, prior if shaped else None, options)
            for n in options.counts
        }
        learners |= {f"{name}, {how}": peer for name, peer in peers(prior if shaped else None, options).items()}
    parts = {
        name: Part(lambda one=one: one.learn(stretch), {"learner-updates": one.count * stretch})
        for name, one in learners.items()
    }
    returns: dict[str, dict[str, float]] = {name: {} for name in learners}

    def tried(stretches: int) -> None:
        updates = stretches * stretch
        if updates == options.early or stretches == options.repeats + 1:
            for name, one in learners.items():
                returns[name][f"return after {updates:,}" if updates < options.updates else LAST] = one.reached()

    rows = harness.time_in_turns(parts, options.repeats, tried)
    for name, one in learners.items():
        rows[name]["environment steps/s"] = rows[name]["learner-updates/s"] * one.steps_per_update
        rows[name] |= returns[name]
    harness.write("shaping", options, rows, bars=bars(rows))


class Ours:
    """A batch of DQN learners, in the programs that the figures run."""

    def __init__(self, count: int, prior: Prior | None, options: Options):
        family = cartpoles()
        tasks = jax.vmap(family.sample_params.with_length)(jnp.full(count, LENGTH))
        shaping = None if prior is None else broadcast(potential_based(prior.network.value), (count,))
        config = DQNConfig(decay_updates=options.updates)
        self.count, self.steps_per_update = count, config.steps_per_update
        self.going = Going(DQN(family, tasks, shaping, config), jax.random.split(jax.random.key(3), count))
        self.learn = self.going.advance

    def reached(self) -> float:
        """Mean greedy return of all learners."""
        return float(np.mean(self.going.reports()["return"]))


class Peer:
    """One learner of another library: how it trains further, and how it is evaluated."""

    count = 1
    steps_per_update = 1

    def __init__(self, learn: Callable[[int], object], act: Callable[[np.ndarray], int]):
        self.learn, self.act = learn, act

    def reached(self) -> float:
        """Mean greedy return of ten unshaped episodes."""
        env, total = gym.make("upslope/CartPole-v0", length=LENGTH), 0.0
        for seed in range(10):
            obs, _ = env.reset(seed=seed)
            done = False
            while not done:
                obs, reward, terminated, truncated, _ = env.step(self.act(obs))
                total, done = total + float(reward), terminated or truncated
        return total / 10


def peers(prior: Prior | None, options: Options) -> dict[str, Peer]:
    """Those that are installed, with upslope's settings as far as they have them."""
    found = {}
    config = DQNConfig(decay_updates=options.updates)
    if importlib.util.find_spec("torch") is not None:
        import torch

        from benchmarks.peers.cleanrl_dqn import CleanDQN

        clean = CleanDQN(environment(prior), config)
        found[CLEAN] = Peer(clean.learn, lambda obs: int(clean.network(torch.from_numpy(obs)).argmax()))
    if importlib.util.find_spec("stable_baselines3") is not None:
        import stable_baselines3

        found[SB3] = of_baselines(stable_baselines3.DQN, prior, config)
    if importlib.util.find_spec("sbx") is not None:
        import sbx

        found[SBX] = of_baselines(sbx.DQN, prior, config)
    return found


def of_baselines(kind: Any, prior: Prior | None, config: DQNConfig) -> Peer:
    """A learner with Stable-Baselines3's interface. It has a Huber loss with another threshold, as it comes."""
    scale, box = (
        np.asarray(cartpoles().observation_scale, np.float32),
        gym.spaces.Box(-np.inf, np.inf, (4,), np.float32),
    )
    env = gym.wrappers.TransformObservation(environment(prior), lambda obs: obs * scale, box)

    def step_size(_: float) -> float:
        updates = max(model.num_timesteps - config.warmup_steps, 0)
        return config.learning_rate * max(0.0, 1 - updates / config.decay_updates)

    model = kind(
        "MlpPolicy", env, learning_rate=config.learning_rate, buffer_size=config.replay_capacity,
        learning_starts=config.warmup_steps, batch_size=config.batch_size, tau=config.target_rate, gamma=0.98,
        train_freq=1, gradient_steps=1, target_update_interval=1, exploration_initial_eps=config.epsilon,
        exploration_final_eps=config.epsilon, policy_kwargs={"net_arch": list(config.hidden)}, seed=0, device="cpu",
    )  # fmt: skip
    model.learn(config.warmup_steps)
    model.lr_schedule = step_size
    return Peer(
        lambda updates: model.learn(updates, reset_num_timesteps=False),
        lambda obs: int(model.predict(obs * scale, deterministic=True)[0]),
    )


def environment(prior: Prior | None) -> gym.Env:
    """Upslope's CartPole for Gymnasium, shaped where there is a prior."""
    env = gym.make("upslope/CartPole-v0", length=LENGTH)
    return env if prior is None else upslope.PotentialShaping(env, prior, gamma=prior.gamma)


def bars(rows: dict[str, Row]) -> list[Bar]:
    """200 learners against one learner after another, and that ours learn."""
    found = []
    for how in ("unshaped", "shaped"):
        own = rows.get(f"upslope, 200 learners, {how}")
        for name, needed in ((SB3, 100), (SBX, 10)):
            peer = rows.get(f"{name}, {how}")
            ratio = own["learner-updates/s"] / peer["learner-updates/s"] if own and peer else None
            what = f"200 learners, {how}: a learner-update at least {needed} × as fast as {name}'s"
            found.append(Bar(what, ratio, needed, bound=_PRODUCTS))
        others = [rows[f"{name}, {how}"][LAST] for name in (SB3, SBX) if f"{name}, {how}" in rows]
        if own and others:
            share = own[LAST] / float(np.mean(others))
            found.append(Bar(f"{how.capitalize()}: reached return at least 0.9 of the mean of those two", share, 0.9))
    return found


_PRODUCTS = (
    "arithmetic in small products: 620,000 operations a learner-update, for weights that no two learners share; "
    "gradients are three quarters of a step (see the profile)"
)

if __name__ == "__main__":
    main(tyro.cli(Options))
