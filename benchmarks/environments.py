"""Environment steps per second, alone, with a policy and with training, against gymnax and Gymnasium's vector classes.

``python -m benchmarks.environments`` writes ``benchmarks/results/environments.json``. gymnax takes part where it is
installed (``pip install gymnax``; 1.0.1 asks for gymnasium < 1.4, with which upslope runs too).

The three levels are the same for all: random actions; the greedy action of a Q-network with two layers of 32; and one
step of Q-learning on the transitions of every step.
"""

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import gymnasium as gym
import jax
import jax.numpy as jnp
import numpy as np
import tyro

from benchmarks import harness
from benchmarks.harness import Bar, Part, Row
from upslope.agents.dqn import dqn_loss
from upslope.maml import descend
from upslope.networks import QNetwork
from upslope.run.compiling import QUICK_TO_RUN, set_up_devices
from upslope.run.randomness import unrolled
from upslope.tasks import cartpoles, obstacle_maps
from upslope.types import Transition

LEVELS = ("alone", "with a policy", "with training")
STEP_SIZE = 1e-3
FOUR_NUMBERS, WHOLE_MAP = "grid, gymnax (Four Rooms)", "grid, gymnax (Four Rooms, its map shown)"

#: Each holds its map in Python's lists, 60 kB; 20,000 of them take a minute to make.
_FROZEN_LAKES = 1000


@dataclass(frozen=True)
class Options(harness.Options):
    """What to time.

    Attributes:
        widths: environments side by side.
        steps: of each width, in one repeat.
        host_steps: of Gymnasium's, which are slower.
        asynchronous: up to how many processes Gymnasium's AsyncVectorEnv is given.
    """

    widths: tuple[int, ...] = (1, 200, 20_000)
    steps: tuple[int, ...] = (20_000, 5_000, 30)
    host_steps: tuple[int, ...] = (5_000, 100, 4)
    asynchronous: int = 8


class Rival(NamedTuple):
    """An environment with gymnax's signature, and what it takes to run it.

    Attributes:
        name: whose it is.
        env: ``reset(key, params)`` and ``step(key, state, action, params)``.
        params: stacked, by the number of environments; or one for all.
        stacked: whether they are.
    """

    name: str
    env: Any
    params: Callable[[int], Any]
    stacked: bool
    shape: tuple[int, ...]
    actions: int


def main(options: Options) -> None:
    """Times all games, widths and levels in turns."""
    if options.quick:
        options = replace(options, repeats=1, widths=(20,), steps=(20,), host_steps=(20,), asynchronous=0)
    set_up_devices(harness.scratch())
    parts: dict[str, Part] = {}
    for width, steps, host_steps in zip(options.widths, options.steps, options.host_steps, strict=True):
        host = on_host(width, options)
        for level in LEVELS:
            for rival in rivals():
                work = {"steps": width * steps}
                parts[f"{rival.name}, {width:,}, {level}"] = Part(compiled(rival, width, steps, level), work)
            for name, envs in host.items():
                parts[f"{name}, {width:,}, {level}"] = Part(
                    hosted(envs, host_steps, level), {"steps": width * host_steps}
                )
    rows = harness.time_in_turns(parts, options.repeats)
    harness.write("environments", options, rows, bars=bars(rows, options))


def rivals() -> list[Rival]:
    """Ours, and gymnax's where it is installed: its CartPole, and its grid, Four Rooms, in both its forms."""
    poles, maps = cartpoles(), obstacle_maps()
    sample = {family.name: jax.jit(family.sample_many, static_argnums=1) for family in (poles, maps)}
    found = [
        Rival("CartPole, upslope", poles.env, lambda n: sample["cartpole"](jax.random.key(0), n), True, (4,), 2),
        Rival("grid, upslope", maps.env, lambda n: sample["grid"](jax.random.key(0), n), True, (8, 8, 4), 4),
    ]
    if importlib.util.find_spec("gymnax") is not None:
        import gymnax

        for name, known, shape, actions in (
            ("CartPole, gymnax", "CartPole-v1", (4,), 2),
            (FOUR_NUMBERS, "FourRooms-misc", (4,), 4),
            (WHOLE_MAP, "FourRooms-misc", (13, 13, 2), 4),
        ):
            env, params = gymnax.make(known, **({"use_visual_obs": True} if name == WHOLE_MAP else {}))
            found.append(Rival(name, env, lambda _, params=params: params, False, shape, actions))
    return found


def compiled(rival: Rival, width: int, steps: int, level: str) -> Callable[[], object]:
    """So many steps of so many environments in one program; what is seen is added up, so that nothing is left out."""
    axis = 0 if rival.stacked else None
    reset = jax.vmap(rival.env.reset, in_axes=(0, axis))
    step = jax.vmap(rival.env.step, in_axes=(0, 0, 0, axis))
    network = QNetwork(jax.random.key(1), int(np.prod(rival.shape)), rival.actions)

    def one_step(carry: tuple, key: jax.Array) -> tuple[tuple, None]:
        obs, state, network, total, params = carry
        action_key, step_key = jax.random.split(key)
        keys = jax.random.split(step_key, width)
        if level == "alone":
            action = jax.random.randint(action_key, (width,), 0, rival.actions)
        else:
            action = jnp.argmax(jax.vmap(network)(flat(obs)), axis=-1)
        following, state, reward, terminated, _, info = step(keys, state, action, params)
        if level == "with training":
            seen = Transition(flat(obs), action, reward, 0.98 * (1.0 - terminated), flat(info["final_observation"]))
            network = descend(network, jax.grad(dqn_loss)(network, network, seen, 3.0), STEP_SIZE)
        total = total + jnp.sum(reward) + jnp.sum(following)
        return (following, state, network, total, params), None

    def flat(obs: jax.Array) -> jax.Array:
        return obs.reshape(width, -1).astype(jnp.float32)

    def play(key: jax.Array, params: Any) -> jax.Array:
        reset_key, key = jax.random.split(key)
        obs, state = reset(jax.random.split(reset_key, width), params)
        carry = (obs, state, network, jnp.zeros(()), params)
        return jax.lax.scan(one_step, carry, jax.random.split(key, steps))[0][3]

    program = jax.jit(play, compiler_options=QUICK_TO_RUN)
    key, params = unrolled(jax.random.key(2)), rival.params(width)
    return lambda: program(key, params).block_until_ready()


def on_host(width: int, options: Options) -> dict[str, Any]:
    """Gymnasium's vector environments, by name: one after the other, in processes, and its CartPole in numpy."""
    found = {
        "CartPole, Gymnasium Sync": gym.make_vec("CartPole-v1", width, "sync"),
        "CartPole, Gymnasium in numpy": gym.make_vec("CartPole-v1", width, "vector_entry_point"),
    }
    if width <= _FROZEN_LAKES:
        lakes = gym.make_vec("FrozenLake-v1", width, "sync", map_name="8x8", is_slippery=False)
        found["grid, Gymnasium Sync (FrozenLake)"] = lakes
    if width <= options.asynchronous:
        kwargs = {"vector_kwargs": {"context": "spawn"}}
        found["CartPole, Gymnasium Async"] = gym.make_vec("CartPole-v1", width, "async", **kwargs)
    return found


def hosted(envs: Any, steps: int, level: str) -> Callable[[], object]:
    """The same on the host; the network runs in one compiled call for all environments."""
    rng = np.random.default_rng(0)
    width, actions = envs.num_envs, int(envs.single_action_space.n)
    discrete = isinstance(envs.single_observation_space, gym.spaces.Discrete)
    inputs = int(envs.single_observation_space.n) if discrete else 4
    network = QNetwork(jax.random.key(1), inputs, actions)

    def flat(obs: np.ndarray) -> np.ndarray:
        return np.eye(inputs, dtype=np.float32)[obs] if discrete else obs

    @jax.jit
    def act(network: QNetwork, obs: jax.Array) -> jax.Array:
        return jnp.argmax(jax.vmap(network)(obs), axis=-1)

    @jax.jit
    def improve(network: QNetwork, seen: Transition) -> QNetwork:
        return descend(network, jax.grad(dqn_loss)(network, network, seen, 3.0), STEP_SIZE)

    obs = envs.reset(seed=0)[0]

    def play() -> None:
        nonlocal obs, network
        for _ in range(steps):
            now = flat(obs)
            action = rng.integers(actions, size=width) if level == "alone" else np.asarray(act(network, now))
            obs, reward, terminated, _, _ = envs.step(action)
            if level == "with training":
                discount = (0.98 * (1.0 - terminated)).astype(np.float32)
                network = improve(network, Transition(now, action, reward.astype(np.float32), discount, flat(obs)))
        jax.block_until_ready(network)

    return play


def bars(rows: dict[str, Row], options: Options) -> list[Bar]:
    """Not behind gymnax at any width, and far before Gymnasium's SyncVectorEnv at the widest."""
    found = []
    for ours, theirs in (
        ("CartPole, upslope", "CartPole, gymnax"),
        ("grid, upslope", WHOLE_MAP),
        ("grid, upslope", FOUR_NUMBERS),
    ):
        for width in options.widths:
            for level in LEVELS:
                pair = [rows.get(f"{name}, {width:,}, {level}") for name in (ours, theirs)]
                ratio = pair[0]["steps/s"] / pair[1]["steps/s"] if all(pair) else None
                found.append(Bar(f"{ours} at {width:,} {level}: not behind {theirs}", ratio, 1.0, bound=_GRID))
    widest = options.widths[-1]
    pair = [rows.get(f"CartPole, {name}, {widest:,}, alone") for name in ("upslope", "Gymnasium Sync")]
    ratio = pair[0]["steps/s"] / pair[1]["steps/s"] if all(pair) else None
    found.append(Bar(f"CartPole at {widest:,}: at least 500 × SyncVectorEnv", ratio, 500, bound=_RANDOM))
    return found


_GRID = (
    "memory, for grids: an observation is the whole map, 256 numbers, where Four Rooms shows four; "
    "for CartPole see the profile"
)

_RANDOM = (
    "arithmetic of random numbers: every environment draws a reset in every step, four blocks of Threefry, and uses "
    "one in some hundred of them; SyncVectorEnv draws only at resets"
)

if __name__ == "__main__":
    main(tyro.cli(Options))
