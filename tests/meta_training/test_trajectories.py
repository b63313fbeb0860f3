"""The posterior along trajectories: Bellman backups by hand, ends of episodes, and replays that are kept."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from upslope.errors import UpslopeError
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.memory import drawn_replays
from upslope.meta_training.posteriors import TrajectoryPosterior
from upslope.meta_training.posteriors.trajectories import Trajectories, pieces
from upslope.networks.dueling import DuelingQ
from upslope.networks.scaling import no_scaling
from upslope.tasks import cartpoles
from upslope.types import Transition

SETTINGS = MetaTrainingConfig(
    tasks=2, steps_per_task=6, hidden=(8, 8), outer_updates=3, kept_iterations=3, random_iterations=2, normalise=True,
    longest_hold=4, posterior=TrajectoryPosterior(environments=2), evaluation_tasks=2, evaluation_episodes=1,
)  # fmt: skip


def samples(start, reward, next_value, next_other, joined, discount=0.5):
    """One environment's steps, without observations."""
    one_row = lambda numbers: jnp.asarray(numbers, jnp.float32)[None]  # noqa: E731
    count = len(reward)
    places = jnp.zeros((1, count, 1))
    seen = Transition(places, jnp.zeros((1, count), jnp.int32), one_row(reward), jnp.full((1, count), discount), places)
    other = None if next_other is None else one_row(next_other)
    return Trajectories(
        seen, one_row(start), one_row(next_value), other, None if joined is None else jnp.asarray([joined])
    )


def posterior_of(data, **settings):
    theta = DuelingQ(jax.random.key(0), 1, 2)
    return np.asarray(TrajectoryPosterior(environments=1, **settings).adapt(theta, data))[0]


class TestBackups:
    def test_one_step_of_size_one_is_a_bellman_backup(self):
        data = samples([9.0, 9.0], [1.0, 2.0], [4.0, 6.0], None, None)
        np.testing.assert_allclose(posterior_of(data), [1 + 0.5 * 4, 2 + 0.5 * 6])

    def test_half_a_step_goes_half_the_way(self):
        data = samples([9.0, 9.0], [1.0, 2.0], [4.0, 6.0], None, None)
        np.testing.assert_allclose(posterior_of(data, inner_step_size=0.5), [6.0, 7.0])

    def test_a_reward_travels_one_step_back_in_each_backup(self):
        data = samples([0.0] * 3, [0, 0, 8.0], [0.0] * 3, [0.0] * 3, [True, True, False])
        for steps, expected in ((2, [0, 4, 8]), (3, [2, 4, 8]), (9, [2, 4, 8])):
            np.testing.assert_allclose(posterior_of(data, inner_steps=steps), expected)

    def test_nothing_travels_past_the_end_of_an_episode(self):
        data = samples([0.0] * 3, [0, 0, 8.0], [0.0, 1.0, 0.0], [0.0] * 3, [True, False, False])
        np.testing.assert_allclose(posterior_of(data, inner_steps=5), [0.25, 0.5, 8])

    def test_another_action_may_be_better_than_the_one_taken(self):
        data = samples([0.0] * 2, [0, -8.0], [3.0, 0.0], [3.0, 0.0], [True, False])
        np.testing.assert_allclose(posterior_of(data, inner_steps=4), [1.5, -8])


class TestDrawing:
    def test_n_steps_begin_with_the_target_network(self):
        posterior = TrajectoryPosterior(environments=2, inner_steps=2)
        target = DuelingQ(jax.random.key(1), 3, 4)
        obs = jax.random.normal(jax.random.key(2), (2, 2, 6, 3))
        action = jax.random.randint(jax.random.key(3), (2, 2, 6), 0, 4)
        data = Transition(obs[:, :, :5], action[:, :, :5], jnp.zeros((2, 2, 5)), jnp.ones((2, 2, 5)), obs[:, :, 1:])
        drawn = posterior.draw(jax.random.split(jax.random.key(4), 2), data, target)
        q = np.array(jax.vmap(jax.vmap(jax.vmap(target)))(obs))
        np.testing.assert_allclose(drawn.next_value, q[:, :, 1:].max(-1), rtol=1e-5, atol=1e-6)
        taken = np.take_along_axis(q, np.asarray(action)[..., None], -1)[..., 0]
        np.testing.assert_allclose(drawn.start, taken[:, :, :5], rtol=1e-5, atol=1e-6)
        np.put_along_axis(q, np.asarray(action)[..., None], -np.inf, -1)
        np.testing.assert_allclose(drawn.next_other[:, :, :4], q[:, :, 1:5].max(-1), rtol=1e-5, atol=1e-6)
        assert np.asarray(drawn.joined)[..., :4].all()

    def test_pieces_are_steps_in_a_row_of_one_trajectory(self):
        numbers = jnp.arange(3 * 9.0).reshape(3, 9)
        data = Transition(numbers[..., None], jnp.zeros((3, 9), jnp.int32), numbers, numbers, numbers[..., None])
        drawn = [np.asarray(pieces(jax.random.key(seed), data, 4).reward) for seed in range(30)]
        for piece in drawn:
            np.testing.assert_array_equal(np.diff(piece), np.ones((3, 3)))
            np.testing.assert_array_equal(piece[:, 0] // 9, piece[:, -1] // 9)
        assert {float(start) for piece in drawn for start in piece[0, :1]} == set(range(6))
        np.testing.assert_array_equal(pieces(jax.random.key(0), data, 20).reward, numbers)

    def test_the_squared_loss_is_in_units_of_the_network(self):
        theta = DuelingQ(jax.random.key(0), 1, 2).with_scaling(replace(no_scaling(1), unit=jnp.asarray(100.0)))
        data = samples([0.0], [0.0], [0.0], None, None)
        q = float(theta.q(jnp.zeros(1), jnp.asarray(0)))
        loss = TrajectoryPosterior().distance(theta, jnp.full((1, 1), q + 300.0), data)
        assert float(loss) == pytest.approx(9.0, rel=1e-4)

    def test_the_huber_loss_is_in_units_of_the_network(self):
        scaling = no_scaling(1)
        theta = DuelingQ(jax.random.key(0), 1, 2).with_scaling(replace(scaling, unit=jnp.asarray(100.0)))
        data = samples([0.0], [0.0], [0.0], None, None)
        q = float(theta.q(jnp.zeros(1), jnp.asarray(0)))
        posterior = TrajectoryPosterior(outer_loss="huber")
        loss = posterior.distance(theta, jnp.full((1, 1), q + 50.0), data)
        assert float(loss) == pytest.approx(0.25, rel=1e-4)
        loss = posterior.distance(theta, jnp.full((1, 1), q + 300.0), data)
        assert float(loss) == pytest.approx(2 * 3 - 1, rel=1e-4)  # beyond one it grows linearly


@pytest.fixture(scope="module")
def states():
    """The states after 0, 1, ... iterations, and what each gathered."""
    learner = MetaTraining(cartpoles(), SETTINGS)
    states, gathered = [jax.jit(learner.init)(jax.random.key(0))], []
    step = jax.jit(lambda state, seen: learner.update(state, seen)[0])
    for _ in range(5):
        gathered.append(jax.jit(learner.gather)(states[-1]))
        states.append(step(states[-1], gathered[-1]))
    return states, gathered


class TestMemory:
    def test_the_latest_iterations_are_kept(self, states):
        states, gathered = states
        kept = np.asarray(states[5].kept.obs)
        for place, iteration in enumerate((3, 4, 2)):
            np.testing.assert_array_equal(kept[2 * place : 2 * place + 2], gathered[iteration].obs)

    def test_draws_come_from_what_is_filled(self, states):
        states, gathered = states
        # The state of an update counts the iterations before its own, whose replays are there already.
        after_one = replace(states[1], iteration=jnp.asarray(0))
        drawn = {
            float(np.asarray(drawn_replays(jax.random.key(i), after_one, SETTINGS).obs)[j, 0, 0, 0])
            for i in range(20)
            for j in range(2)
        }
        assert drawn == {float(gathered[0].obs[task, 0, 0, 0]) for task in range(2)}

    def test_the_scaling_is_that_of_the_random_iterations_and_stays(self, states):
        states, gathered = states
        obs = np.concatenate([np.asarray(seen.obs).reshape(-1, 4) for seen in gathered[:2]])
        for state in states[2:]:
            for network in (state.theta, state.target, state.average):
                np.testing.assert_allclose(network.scaling.mean, obs.mean(0), atol=1e-5)
        assert float(states[5].theta.scaling.unit) == pytest.approx(float(states[2].theta.scaling.unit))

    def test_the_target_follows_in_every_outer_step(self, states):
        states, _ = states
        moved = jax.tree.map(lambda a, b: float(jnp.abs(a - b).max()), states[3].target, states[2].target)
        assert max(jax.tree.leaves(moved)) > 0

    def test_normalising_needs_random_steps(self):
        with pytest.raises(UpslopeError, match="random_iterations is 0"):
            MetaTrainingConfig(normalise=True)


def test_the_first_iterations_act_at_random():
    family = cartpoles()
    learner = MetaTraining(family, replace(SETTINGS, epsilon=(0.0, 0.0), random_iterations=1))
    state = learner.init(jax.random.key(0))
    explorer = learner.config.explorer
    epsilons = [explorer(jnp.asarray(iteration))(state.theta, jnp.zeros(4)).epsilon for iteration in (0, 1)]
    np.testing.assert_array_equal(epsilons, [[1.0] * 4, [0.0] * 4])
