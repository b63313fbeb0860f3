"""The posterior as a table: experience by numbers of states, backups, the weights of Eq. 7, DQN as a special case."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from upslope.meta_training.finite_posterior import (
    FiniteSamples,
    Steps,
    posterior_heads,
    posterior_table,
    posterior_weights,
    q_tables,
    table_distance,
)

from support.comparing import assert_trees_close, largest
from support.probes import discrete_family
from upslope.equations.losses import td_loss
from upslope.errors import UpslopeError
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.recipes import for_grid_games, multi_task_dqn
from upslope.planning.exact import solve_all, tabulate
from upslope.tasks import grid_games

MAPS, CELLS, ACTIONS = 2, 12, 4


@pytest.fixture(scope="module")
def family():
    return grid_games((3, 4), obstacles=0.15)


@pytest.fixture(scope="module")
def meta(family):
    config = dataclasses.replace(for_grid_games(4), hidden=(8, 8), environments=4, steps_per_task=60, outer_warmup=0)
    return MetaTraining(family, config)


@pytest.fixture(scope="module")
def state(meta):
    return jax.jit(lambda: meta.init(jax.random.key(0)))()


@pytest.fixture(scope="module")
def tasks(family):
    return family.sample_many(jax.random.key(3), MAPS)


@pytest.fixture(scope="module")
def samples(meta, state, tasks) -> FiniteSamples:
    return jax.jit(lambda tasks: meta.collect(jax.random.key(1), tasks, state.theta))(tasks)


@pytest.fixture(scope="module")
def theta(state):
    """Not as it begins: with biases of zero, ReLUs stand at their kinks where a map is empty."""
    leaves, structure = jax.tree.flatten(state.theta)
    keys = jax.random.split(jax.random.key(7), len(leaves))
    noisy = [leaf + 0.05 * jax.random.normal(key, leaf.shape) for leaf, key in zip(leaves, keys, strict=True)]
    return jax.tree.unflatten(structure, noisy)


@pytest.fixture(scope="module")
def observations(samples):
    return samples.observations[0]


def steps_of(*rows) -> Steps:
    """Rows of state, action, reward, discount, successor, share."""
    columns = [jnp.asarray(column) for column in zip(*rows, strict=True)]
    ints = (0, 1, 4)
    return Steps(*(c.astype(jnp.int32) if i in ints else c.astype(jnp.float32) for i, c in enumerate(columns)))


class TestCollecting:
    def test_steps_are_those_of_the_map(self, family, tasks, samples):
        for index in range(MAPS):
            task = jax.tree.map(lambda leaf, i=index: leaf[i], tasks)
            steps = jax.tree.map(lambda leaf, i=index: np.asarray(leaf[i]), samples.steps)
            mdp = tabulate(family.env, task, family.gamma)
            at = (steps.state, steps.action, 0)
            np.testing.assert_array_equal(steps.successor, mdp.successors[at])
            np.testing.assert_array_equal(steps.reward, mdp.rewards[at])
            np.testing.assert_allclose(steps.discount, mdp.discounts[at])
            assert steps.state[0] == task.start
            assert len(np.unique(steps.state)) > 2

    def test_shares_of_a_pair_add_up_to_one(self, samples):
        for index in range(MAPS):
            steps = jax.tree.map(lambda leaf, i=index: np.asarray(leaf[i]), samples.steps)
            totals = np.zeros((CELLS, ACTIONS))
            np.add.at(totals, (steps.state, steps.action), steps.share)
            np.testing.assert_allclose(totals[totals > 0], 1.0, rtol=1e-5)

    def test_environments_of_a_map_have_their_own_epsilon(self, family, state, tasks):
        config = dataclasses.replace(for_grid_games(4), hidden=(8, 8), environments=2, steps_per_task=200)
        meta = MetaTraining(family, dataclasses.replace(config, epsilon=(0.0, 1.0)))
        seen = jax.jit(lambda tasks: meta.collect(jax.random.key(1), tasks, state.theta))(tasks)
        greedy = np.asarray(jnp.argmax(q_tables(state.theta, seen.observations), axis=-1))
        for index in range(MAPS):
            strayed = np.asarray(seen.steps.action[index]) != greedy[index][np.asarray(seen.steps.state[index])]
            assert strayed[:200].mean() == 0
            assert strayed[200:].mean() == pytest.approx(0.75, abs=0.12)


class TestInnerSteps:
    def test_one_step_of_size_one_is_a_bellman_backup(self):
        table = jnp.array([[1.0, 2.0], [5.0, 3.0]])
        steps = steps_of((0, 0, 0.5, 0.9, 1, 1.0), (1, 1, 1.0, 0.0, 0, 1.0))
        found = posterior_table(table, steps, step_size=1.0, inner_steps=1)
        np.testing.assert_allclose(found, [[0.5 + 0.9 * 5, 2.0], [5.0, 1.0]], rtol=1e-6)

    def test_a_pair_seen_with_two_outcomes_moves_to_their_mean(self):
        table = jnp.array([[0.0, 2.0], [4.0, 0.0]])
        steps = steps_of((0, 0, 1.0, 0.5, 1, 0.5), (0, 0, 0.0, 0.0, 1, 0.5))
        found = posterior_table(table, steps, step_size=0.5, inner_steps=1)
        # Targets 1 + 0.5·4 = 3 and 0, their mean 1.5; half of the way from 0.
        np.testing.assert_allclose(found, [[0.75, 2.0], [4.0, 0.0]], rtol=1e-6)

    def test_many_steps_on_all_pairs_solve_the_map(self, family, tasks):
        solution = solve_all(family.env, tasks, family.gamma)
        for index in range(MAPS):
            mdp = tabulate(family.env, jax.tree.map(lambda leaf, i=index: leaf[i], tasks), family.gamma)
            cell, action = np.nonzero(np.broadcast_to(mdp.acting[:, None], (CELLS, ACTIONS)))
            at = (cell, action, 0)
            steps = Steps(
                jnp.asarray(cell, jnp.int32), jnp.asarray(action, jnp.int32), mdp.rewards[at], mdp.discounts[at],
                mdp.successors[at], jnp.ones(len(cell)),
            )  # fmt: skip
            start = jax.random.normal(jax.random.key(5), (CELLS, ACTIONS))
            found = posterior_table(start, steps, step_size=1.0, inner_steps=150)
            where = np.asarray(mdp.acting)
            np.testing.assert_allclose(found[where], solution.action_value[index][where], atol=1e-4)


class TestWeightsThatAdapt:
    """The two heads, and all weights, on everything that was seen."""

    STEPS = steps_of((0, 0, 0.5, 0.9, 1, 1.0), (5, 2, 1.0, 0.0, 0, 0.5), (5, 2, 0.0, 0.9, 3, 0.5))

    @pytest.mark.parametrize("posterior", [posterior_heads, posterior_weights])
    def test_a_step_goes_down_the_mean_of_equation_5(self, theta, observations, posterior):
        def loss(network):
            q = jax.vmap(network)(observations)
            targets = jax.lax.stop_gradient([0.5 + 0.9 * q[1].max(), 1.0, 0.9 * q[3].max()])
            first, *second = (
                (target - value) ** 2 for target, value in zip(targets, q[(0, 5, 5), (0, 2, 2)], strict=True)
            )
            return (first + sum(second) / 2) / 2  # two pairs, the second of them seen twice

        slope = jax.jit(jax.grad(loss))(theta)
        if posterior is posterior_heads:
            slope = eqx.tree_at(lambda net: net.torso, slope, jax.tree.map(jnp.zeros_like, slope.torso))
        expected = jax.vmap(jax.tree.map(lambda p, g: p - 0.1 * g, theta, slope))(observations)
        found = jax.jit(lambda: posterior(theta, observations, self.STEPS, step_size=0.1, steps=1))()
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5)
        assert largest(found - jax.vmap(theta)(observations)) > 1e-3

    def test_a_normalised_step_removes_its_share_of_one_error(self, theta, observations):
        """Heads are linear: of a single pair's TD error, which V alone can mend, a whole step leaves nothing."""
        best = int(jax.vmap(theta)(observations)[2].argmax())
        one = steps_of((2, best, 1.0, 0.0, 0, 1.0))
        before = float(jax.vmap(theta)(observations)[2, best])
        for share in (1.0, 0.4):
            found = posterior_heads(theta, observations, one, step_size=share, steps=1, normalised=True)
            assert float(found[2, best]) == pytest.approx(before + share * (1 - before), abs=2e-4)

    @pytest.mark.parametrize(("name", "posterior"), [("heads", posterior_heads), ("weights", posterior_weights)])
    def test_algorithm_1_goes_to_where_they_are(self, family, theta, samples, name, posterior):
        inner = {"inner_step_size": 0.3, "inner_steps": 2, "normalised_steps": True}
        meta = MetaTraining(family, dataclasses.replace(for_grid_games(4), hidden=(8, 8), posterior=name, **inner))
        aims = [
            posterior(theta, *jax.tree.map(lambda leaf, i=task: leaf[i], (samples.observations, samples.steps)),
                      step_size=0.3, steps=2, normalised=True)
            for task in range(MAPS)
        ]  # fmt: skip

        def distance(network):
            def of_task(task):
                seen, steps = jax.tree.map(lambda leaf: leaf[task], (samples.observations, samples.steps))
                q = jax.vmap(network)(seen)
                return table_distance(q, aims[task], steps, reward_weight=5.0, advantage_weight=30.0)

            return sum(of_task(task) for task in range(MAPS)) / MAPS

        expected, slope = jax.jit(jax.value_and_grad(distance))(theta)
        loss, gradient = jax.jit(lambda network: meta.outer_gradient(network, samples))(theta)
        assert float(loss) == pytest.approx(float(expected), rel=1e-3)
        assert largest(slope) > 1e-3
        assert_trees_close(gradient, slope, rtol=5e-3, atol=1e-4)


class TestOuterLoss:
    PRIOR = jnp.array([[1.0, 0.0, 7.0], [2.0, 2.0, 2.0]])
    POSTERIOR = jnp.array([[0.0, 2.0, 9.0], [2.0, 2.0, 1.0]])
    # Tried: (0, 0), (0, 1) and, with a reward, (1, 2): errors 1, −2 and 1.
    STEPS = steps_of((0, 0, 0, 0.9, 1, 1), (0, 1, 0, 0.9, 0, 0.5), (0, 1, 0, 0.9, 0, 0.5), (1, 2, 1, 0, 0, 1))

    @pytest.mark.parametrize(
        ("reward_weight", "advantage_weight", "expected"),
        [
            (1.0, 0.0, (1 + 4 + 1) / 3),
            (5.0, 0.0, (1 + 4 + 5 * 1) / 7),
            # In state 0 the errors differ from their mean −½ by ±1.5; in state 1 there is only one.
            (1.0, 2.0, (1 + 4 + 1 + 2 * (2.25 + 2.25)) / 3),
        ],
    )
    def test_by_hand(self, reward_weight, advantage_weight, expected):
        found = table_distance(
            self.PRIOR, self.POSTERIOR, self.STEPS, reward_weight=reward_weight, advantage_weight=advantage_weight
        )
        assert float(found) == pytest.approx(expected)

    def test_the_posterior_is_a_constant(self):
        slope = jax.grad(
            lambda posterior: table_distance(self.PRIOR, posterior, self.STEPS, reward_weight=5.0, advantage_weight=2.0)
        )(self.POSTERIOR)
        assert largest(slope) == 0


def test_multi_task_dqn_has_the_gradient_of_dqn(family, state, samples):
    """One backup of the averaged network, and Eq. 7: nothing else than Eq. 5 with a frozen target."""
    config = dataclasses.replace(multi_task_dqn(4), hidden=(8, 8), reward_weight=1.0)
    meta = MetaTraining(family, config)
    target = jax.jit(lambda: MetaTraining(family, config).init(jax.random.key(9)))().theta
    one = jax.tree.map(lambda leaf: leaf[:1], samples)

    @jax.jit
    def both(theta):
        _, ours = meta.outer_gradient(theta, meta.draw(jax.random.key(0), one, target))
        steps, seen = jax.tree.map(lambda leaf: leaf[0], one.steps), one.observations[0]
        # Each pair once, as the table counts them.
        first = jnp.zeros((CELLS, ACTIONS), jnp.int32).at[steps.state, steps.action].set(jnp.arange(len(steps.state)))
        weights = (first[steps.state, steps.action] == jnp.arange(len(steps.state))).astype(jnp.float32)

        def loss(network):
            q, next_q = jax.vmap(network)(seen), jax.vmap(target)(seen)
            losses = jax.vmap(td_loss)(
                q[steps.state], steps.action, steps.reward, steps.discount, next_q[steps.successor]
            )
            return jnp.sum(weights * losses) / jnp.sum(weights)

        return ours, jax.grad(loss)(theta)

    ours, theirs = both(state.theta)
    assert largest(theirs) > 1e-3
    assert_trees_close(ours, theirs, rtol=2e-3, atol=1e-5)


def test_an_iteration_moves_theta_towards_the_posterior(meta, state, samples):
    loss, gradient = jax.jit(lambda theta: meta.outer_gradient(theta, samples))(state.theta)
    nearer = jax.tree.map(lambda p, g: p - 1e-3 * g, state.theta, gradient)
    assert float(jax.jit(lambda theta: meta.outer_loss(theta, samples))(nearer)) < float(loss)


class TestRefusals:
    def test_tasks_that_are_not_finite(self):
        with pytest.raises(UpslopeError, match="not finite"):
            MetaTraining(discrete_family(), for_grid_games(4)).init(jax.random.key(0))

    def test_a_kept_target(self):
        with pytest.raises(UpslopeError, match="outer_target"):
            MetaTrainingConfig(posterior="table", outer_target="kept")

    def test_a_target_network_for_adapted_weights(self):
        with pytest.raises(UpslopeError, match="target_decay=None"):
            MetaTrainingConfig(posterior="heads")

    def test_normalised_steps_of_a_table(self):
        with pytest.raises(UpslopeError, match="normalised_steps"):
            MetaTrainingConfig(posterior="table", normalised_steps=True)


def test_the_control_differs_only_in_what_makes_it_dqn():
    ours, theirs = dataclasses.asdict(for_grid_games()), dataclasses.asdict(multi_task_dqn())
    assert {name for name in ours if ours[name] != theirs[name]} == {"inner_steps", "target_decay", "advantage_weight"}
