"""Potentials as tables over cells: the same numbers as the networks, and the same learners up to rounding."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.comparing import assert_trees_close
from support.plain_grids import as_board, distances, draw, pick
from upslope.envs.grid import read_map
from upslope.errors import UpslopeError
from upslope.experiments.maps.arms import grid_arms, mean_levels_on_maps, value_tables
from upslope.experiments.maps.priors import mean_detours
from upslope.learners.dqn import DQN, DQNConfig
from upslope.learners.shaping import potential_based
from upslope.networks.dueling import DuelingQ
from upslope.planning.grid_potentials import CellPotential
from upslope.planning.measures import truths
from upslope.run.loop import broadcast, run
from upslope.tasks import grid_games

#: Flat observations: fully connected networks, which compile in no time.
FAMILY = grid_games((4, 4), max_steps=12, flat=True)


class Case(NamedTuple):
    """Two networks and two of the control on three maps, and the arms that they give."""

    maps: Any
    networks: Any
    control: Any
    levels: Any
    arms: Any


@eqx.filter_jit
def stacked_networks(first_seed):
    seeds = first_seed + jnp.arange(2)
    return jax.vmap(lambda seed: DuelingQ(jax.random.key(seed), FAMILY.observation_shape, 4, (8,)))(seeds)


@pytest.fixture(scope="module")
def case() -> Case:
    maps, networks, control = draw(FAMILY, 3), stacked_networks(0), stacked_networks(10)
    levels = jnp.asarray([0.25, 0.5])
    return Case(maps, networks, control, levels, grid_arms(FAMILY, maps, networks, control, levels))


def network(case, seed):
    return jax.tree.map(lambda leaf: leaf[seed], case.networks)


def test_tables_hold_what_the_networks_say_in_every_cell(case):
    values = value_tables(FAMILY, case.maps, case.networks)
    assert values.shape == (2, 3, 16)
    for seed in range(2):
        for index in range(3):
            for cell in (0, 7, 15):
                obs = FAMILY.env.observe(pick(case.maps, index), jnp.asarray(cell))
                assert float(values[seed, index, cell]) == pytest.approx(
                    float(network(case, seed).value(obs)), abs=1e-6
                )


def test_arms(case):
    own, others = value_tables(FAMILY, case.maps, case.networks), value_tables(FAMILY, case.maps, case.control)
    assert all(arm.potential.values.shape == (2, 3, 16) for arm in case.arms.values())
    values = {name: np.asarray(arm.potential.values) for name, arm in case.arms.items()}
    np.testing.assert_array_equal(values["unshaped"], 0)
    np.testing.assert_array_equal(values["constant"], np.broadcast_to(case.levels[:, None, None], (2, 3, 16)))
    np.testing.assert_array_equal(values["prior"], own)
    np.testing.assert_array_equal(values["prior_unzeroed"], own)
    np.testing.assert_allclose(values["prior_ensemble"], np.broadcast_to(own.mean(0), own.shape), rtol=1e-6)
    np.testing.assert_array_equal(values["multi_task_dqn"], others)
    for index in range(3):
        for cell, way in enumerate(distances(as_board(pick(case.maps, index))).ravel()):
            expected = 0.9 ** (way - 1) if way > 0 else 0.0
            assert values["oracle"][0, index, cell] == pytest.approx(expected, abs=1e-6)
            # The path is never shorter than the rows and columns to the goal.
            assert values["manhattan"][0, index, cell] >= expected - 1e-6


def test_one_arm_alone_keeps_its_potential_at_terminal_states(case):
    for name, arm in case.arms.items():
        np.testing.assert_allclose(arm.terminal_discount, 0.9 if name == "prior_unzeroed" else 0.0, rtol=1e-6)


def test_the_level_is_the_mean_over_cells_that_count(case):
    states = np.asarray(truths(FAMILY.env, case.maps, FAMILY.gamma).states)
    own = np.asarray(value_tables(FAMILY, case.maps, case.networks))
    expected = [own[seed][states].mean() for seed in range(2)]
    np.testing.assert_allclose(mean_levels_on_maps(FAMILY, case.maps, case.networks), expected, rtol=1e-5)


@pytest.mark.slow
def test_a_learner_shaped_by_the_table_is_one_shaped_by_the_network(case):
    """F differs by rounding only; thirty updates may amplify this a little."""
    task = jax.tree.map(jnp.asarray, pick(case.maps, 0))
    config = DQNConfig(hidden=(8,), batch_size=8, warmup_steps=20, replay_capacity=64, learning_rate=1e-3)
    finished = []
    for potential in (network(case, 1).value, CellPotential(case.arms["prior"].potential.values[1, 0])):
        learner = broadcast(DQN(FAMILY, task, potential_based(potential), config), (1,))
        finished.append(run(learner, jax.random.split(jax.random.key(3), 1), updates=30, every=30))
    by_network, by_table = finished
    assert_trees_close(by_network.states.network, by_table.states.network, rtol=1e-3, atol=1e-5)
    assert float(jnp.abs(by_table.metrics["shaped_reward"][0, -1])) > 1e-3, "nothing was shaped"
    np.testing.assert_array_equal(by_network.reports["return"], by_table.reports["return"])


def test_detours_by_hand():
    """A path must go around a wall of two cells between start and goal."""
    rows = read_map("S#G\n.#.\n...")
    maps = jax.tree.map(lambda leaf: leaf[None], rows)
    family = grid_games((3, 3))
    detour = mean_detours(family, truths(family.env, maps, family.gamma), maps)
    # Six steps instead of two from the start, five instead of three from below it, none too many from the four others.
    assert detour.tolist() == [(4 + 2) / 6]


def test_clean_maps_ask_for_no_detours():
    family = grid_games((5, 6), obstacles=0.0)
    maps = draw(family, 20)
    assert not mean_detours(family, truths(family.env, maps, family.gamma), maps).any()


def test_detours_lead_around_traps_at_any_discount():
    maps = jax.tree.map(lambda leaf: leaf[None], read_map("STG\n...", trap_penalty=0.0))
    for gamma in (0.9, 0.01):
        family = grid_games((2, 3), traps=0.1, gamma=gamma)
        # Four steps instead of two from the start; none too many from the three cells below.
        detour = mean_detours(family, truths(family.env, maps, gamma), maps)
        assert detour.tolist() == [2 / 4]


def test_slippery_maps_have_no_detours():
    family = grid_games((3, 3), slip=0.2)
    maps = draw(family, 2)
    with pytest.raises(UpslopeError, match="Where moves slip there is no shortest path"):
        mean_detours(family, truths(family.env, maps, family.gamma), maps)
