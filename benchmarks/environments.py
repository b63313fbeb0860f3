"""Environment steps per second, alone, with a policy and with training, against gymnax and Gymnasium's vector classes.

``python -m benchmarks.environments`` writes ``benchmarks/results/environments.json``. gymnax takes part where it is
installed (``pip install --no-deps gymnax``: 1.0.1 asks for an older Gymnasium than it needs).

The three levels are the same for all: random actions; the greedy action of a Q-network with two layers of 32; and one
step of Q-learning on the transitions of every step.
"""

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from jax.sharding import NamedSharding, PartitionSpec

from benchmarks import harness
from benchmarks.harness import Bar, Part, Row, number
from benchmarks.host_environments import STEP_SIZE, hosted, on_host
from upslope.compiler_options import QUICK_TO_RUN
from upslope.equations.maml import descend
from upslope.learners.dqn import dqn_loss
from upslope.networks.q_network import QNetwork
from upslope.run.compiling import set_up_devices
from upslope.run.randomness import unroll
from upslope.tasks import cartpoles, obstacle_maps
from upslope.types import Transition

#: A device for each core; and what a step draws for the resets that it may need.
ON_ALL_CORES, RESETS = "CartPole, upslope, all cores", "CartPole, upslope, a reset drawn in each step and nothing else"
LEVELS = ("alone", "with a policy", "with training")
FOUR_NUMBERS, WHOLE_MAP = "grid, gymnax (Four Rooms)", "grid, gymnax (Four Rooms, its map shown)"


@dataclass(frozen=True)
class Options(harness.Options):
    """What to time.

    Attributes:
        widths: environments in a batch.
        steps: of each width, in one repeat.
        host_steps: of Gymnasium's, which are slower.
        numpy_steps: of its CartPole in numpy.
        asynchronous: up to how many processes Gymnasium's AsyncVectorEnv is given.
    """

    widths: tuple[int, ...] = (1, 200, 20_000)
    steps: tuple[int, ...] = (20_000, 5_000, 200)
    host_steps: tuple[int, ...] = (5_000, 100, 4)
    numpy_steps: tuple[int, ...] = (5_000, 2_000, 200)
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
        options = replace(
            options, repeats=1, widths=(20,), steps=(20,), host_steps=(20,), numpy_steps=(20,), asynchronous=0
        )
    set_up_devices(harness.scratch())
    parts: dict[str, Part] = {}
    for width, steps, host_steps, numpy_steps in zip(
        options.widths, options.steps, options.host_steps, options.numpy_steps, strict=True
    ):
        host = on_host(width, host_steps, numpy_steps, options.asynchronous)
        for level in LEVELS:
            for rival in rivals():
                work = {"steps": width * steps}
                parts[f"{rival.name}, {width:,}, {level}"] = Part(compiled(rival, width, steps, level), work)
            for name, (envs, count) in host.items():
                parts[f"{name}, {width:,}, {level}"] = Part(hosted(envs, count, level), {"steps": width * count})
    width, steps = options.widths[-1], options.steps[-1]
    ours, work = rivals()[0], {"steps": width * steps}
    parts[f"{ON_ALL_CORES}, {width:,}, alone"] = Part(on_all_cores(ours, width, steps), work)
    parts[f"{RESETS}, {width:,}"] = Part(resets(ours, width, steps), work)
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
    """Steps of a batch of environments in one program, on one device."""
    program = jax.jit(player(rival, width, steps, level), compiler_options=QUICK_TO_RUN)
    key, params = unroll(jax.random.key(2)), rival.params(width)
    return lambda: program(key, params).block_until_ready()


def on_all_cores(rival: Rival, width: int, steps: int) -> Callable[[], object]:
    """The same at random, the environments shared out to a device for each core."""
    devices = jax.device_count()
    mesh, cores = jax.make_mesh((devices,), ("cores",)), PartitionSpec("cores")
    play = player(rival, width // devices, steps, "alone")
    share = jax.shard_map(
        lambda key, params: play(key[0], params)[None], mesh=mesh, in_specs=(cores, cores), out_specs=cores,
        check_vma=False,
    )  # fmt: skip
    program = jax.jit(share, compiler_options=QUICK_TO_RUN)
    given = (unroll(jax.random.split(jax.random.key(2), devices)), rival.params(width // devices * devices))
    key, params = jax.device_put(given, NamedSharding(mesh, cores))
    return lambda: program(key, params).block_until_ready()


def resets(rival: Rival, width: int, steps: int) -> Callable[[], object]:
    """What steps draw for resets, and nothing else: a part of the budget of a step."""
    reset = jax.vmap(rival.env.reset)

    @partial(jax.jit, compiler_options=QUICK_TO_RUN)
    def program(key: jax.Array, params: Any) -> jax.Array:
        def one_step(total: jax.Array, key: jax.Array) -> tuple[jax.Array, None]:
            return total + jnp.sum(reset(jax.random.split(key, width), params)[0]), None

        return jax.lax.scan(one_step, jnp.zeros(()), jax.random.split(key, steps))[0]

    key, params = unroll(jax.random.key(2)), rival.params(width)
    return lambda: program(key, params).block_until_ready()


def player(rival: Rival, width: int, steps: int, level: str) -> Callable[[jax.Array, Any], jax.Array]:
    """A function of a key and of tasks; observations are summed, so that the compiler leaves nothing out."""
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
            action = jax.vmap(network.best)(flat(obs))
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

    return play


def bars(rows: dict[str, Row], options: Options) -> list[Bar]:
    """Not behind gymnax at any width, and far before Gymnasium's SyncVectorEnv at the widest."""
    found = []
    for ours, theirs, bound in _PAIRS:
        for width in options.widths:
            for level in LEVELS:
                pair = [rows.get(f"{name}, {width:,}, {level}") for name in (ours, theirs)]
                ratio = pair[0]["steps/s"] / pair[1]["steps/s"] if all(pair) else None
                found.append(Bar(f"{ours} at {width:,} {level}: at least as fast as {theirs}", ratio, 1.0, bound=bound))
    widest = options.widths[-1]
    nanoseconds = {
        name: 1e9 / rows[name]["steps/s"]
        for name in (
            f"CartPole, upslope, {widest:,}, alone",
            f"{ON_ALL_CORES}, {widest:,}, alone",
            f"{RESETS}, {widest:,}",
            f"CartPole, Gymnasium Sync, {widest:,}, alone",
        )
    }
    one, all_cores, drawing, sync = nanoseconds.values()
    what = f"CartPole at {widest:,}, on all cores: at least 500 × SyncVectorEnv"
    return [*found, Bar(what, sync / all_cores, 500, bound=_budget(one, all_cores, drawing, sync))]


def _budget(one: float, all_cores: float, drawing: float, sync: float) -> str:
    """Nanoseconds of a step of one environment, and where they go."""
    return (
        f"SyncVectorEnv takes {number(sync)} ns a step, so the bar leaves {number(sync / 500)}; upslope takes "
        f"{number(one)} on one device, and {number(all_cores)} on a device for each core. About {number(drawing)} are "
        "the random numbers of a reset, which every environment draws in every step and uses about once in a hundred "
        "(SyncVectorEnv draws at resets only). The physics wait for coordinates that lie side by side, [n, 4]: in "
        "arrays of their own they alone took 10 to 14 ns (an exploration)"
    )


_PAIRS = (
    ("CartPole, upslope", "CartPole, gymnax", "random numbers: both draw those of a reset in every step"),
    (
        "grid, upslope",
        WHOLE_MAP,
        "memory, likely: both make the picture of a whole map in every step, 256 numbers here and 338 there; "
        "which part takes how long is not measured",
    ),
    (
        "grid, upslope",
        FOUR_NUMBERS,
        "memory and arithmetic: an observation is the whole map, 256 numbers where this form of Four Rooms shows four, "
        "and the first layer of a network on it has 64 times as many weights",
    ),
)

if __name__ == "__main__":
    main(tyro.cli(Options))
