"""The one loop: marks, shapes, padding, determinism, compiling once, observers, divergence."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.comparing import assert_trees_identical
from support.toys import Memory, walks
from upslope.errors import UpslopeError
from upslope.learners.dqn import DQN
from upslope.priors.potentials import stack
from upslope.run.compiling import CompileClock
from upslope.run.engines import CompiledEngine
from upslope.run.engines.compiled import block_size
from upslope.run.loop import broadcast, run
from upslope.run.session import Session
from upslope.tasks import cartpoles, obstacle_maps

DRIFTS = [0.0, 1.0, 2.0]


def keys(count, seed=0):
    return jax.random.split(jax.random.key(seed), count)


def walk(drifts=DRIFTS, *, updates=7, every=3, seed=0, **settings):
    learners = walks(drifts)
    batch = learners.drift.shape
    return run(learners, keys(int(np.prod(batch)), seed).reshape(batch), updates=updates, every=every, **settings)


def test_there_are_two_devices_to_spread_over():
    assert len(jax.local_devices()) >= 2


class TestMarksAndShapes:
    @pytest.mark.parametrize(
        ("updates", "every", "marks"),
        [(7, 3, [0, 3, 6, 7]), (6, 3, [0, 3, 6]), (2, 5, [0, 2]), (1, 1, [0, 1]), (3, 1, [0, 1, 2, 3])],
    )
    def test_reports_come_before_the_first_step_after_every_few_and_after_the_last(self, updates, every, marks):
        outcome = walk(updates=updates, every=every)
        assert outcome.updates.tolist() == marks
        assert outcome.states.steps.tolist() == [updates] * 3

    @pytest.mark.parametrize(
        ("until", "marks"), [(0, [0]), (1, [0, 3]), (3, [0, 3]), (4, [0, 3, 6]), (7, [0, 3, 6, 7]), (9, [0, 3, 6, 7])]
    )
    def test_a_run_can_end_at_an_earlier_mark(self, until, marks):
        memory, whole = Memory(), walk()
        short = walk(until=until, session=Session([memory]))
        assert short.updates.tolist() == marks
        assert short.states.steps.tolist() == [marks[-1]] * 3
        assert memory.calls[0] == ("begin", "learning", marks[-1], 3)
        of_whole = jax.tree.map(lambda leaf: leaf[:, : len(marks)], (whole.reports, whole.metrics))
        assert_trees_identical((short.reports, short.metrics), of_whole)

    def test_metrics_are_means_over_chunks(self):
        # Steps 1 to 3, 4 to 6, and 7; nothing before the first.
        np.testing.assert_allclose(walk().metrics["step"], [[0, 2, 5, 7]] * 3)

    def test_reports_are_of_the_states_at_the_marks(self):
        outcome = walk()
        assert outcome.reports["return"].shape == (3, 4)
        assert outcome.reports["pair"].shape == (3, 4, 2)
        np.testing.assert_array_equal(outcome.reports["return"][:, 0], 0)
        np.testing.assert_array_equal(outcome.reports["return"][:, -1], outcome.states.place)
        np.testing.assert_array_equal(outcome.reports["pair"][..., 1], -outcome.reports["return"])

    def test_each_learner_has_its_own_settings(self):
        np.testing.assert_allclose(walk().states.place, [0, 7, 14], atol=2)

    @pytest.mark.parametrize("shape", [(), (1,), (2, 3)])
    def test_batches_of_any_shape(self, shape):
        outcome = walk(np.arange(np.prod(shape, dtype=int), dtype=np.float32).reshape(shape))
        assert outcome.states.place.shape == shape
        assert outcome.reports["pair"].shape == (*shape, 4, 2)
        assert outcome.metrics["step"].shape == (*shape, 4)

    def test_axes_keep_their_order(self):
        drifts = 10.0 * np.arange(6).reshape(2, 3)
        np.testing.assert_allclose(walk(drifts).states.place, 7 * drifts, atol=2)

    def test_settings_without_a_batch_axis_are_shared_by_all(self):
        shared = eqx.tree_at(lambda walk: walk.drift, walks(DRIFTS), jnp.asarray(4.0))
        np.testing.assert_allclose(run(shared, keys(3), updates=7, every=3).states.place, 28, atol=2)

    def test_broadcast_copies_a_learner(self):
        copies = broadcast(walks(1.5), (2, 3))
        np.testing.assert_array_equal(copies.drift, np.full((2, 3), 1.5))


class TestBatching:
    def test_padding_to_the_devices_leaves_no_trace(self):
        odd, even = walk([0.0, 1.0, 2.0]), run(walks([0.0, 1.0, 2.0, 5.0]), keys(4), updates=7, every=3)
        assert odd.reports["return"].shape[0] == 3
        singles = [run(walks([drift]), keys(3)[i][None], updates=7, every=3) for i, drift in enumerate(DRIFTS)]
        for index, single in enumerate(singles):
            np.testing.assert_allclose(odd.reports["return"][index], single.reports["return"][0], rtol=1e-5)
        assert even.reports["return"].shape[0] == 4

    def test_blocks_of_learners_leave_no_trace(self):
        """Twenty learners on each of two devices take their steps ten at a time, three all at once."""
        assert (block_size(walks(0.0), 20), block_size(walks(0.0), 3)) == (10, 3)
        drifts = [float(index) for index in range(40)]
        many = walk(drifts)
        few = run(walks(drifts[17:23]), keys(40)[17:23], updates=7, every=3)
        assert_trees_identical(jax.tree.map(lambda leaf: leaf[17:23], many.states), few.states)
        assert_trees_identical(jax.tree.map(lambda leaf: leaf[17:23], many.reports), few.reports)
        np.testing.assert_allclose(many.states.place, 7 * np.asarray(drifts), atol=2)

    def test_a_block_that_breaks_is_reported_with_its_learner(self):
        breaks_at = jnp.where(jnp.arange(40) == 23, 5, -1)
        learners = eqx.tree_at(lambda walk: walk.breaks_at, walks([0.0] * 40), breaks_at)
        with pytest.raises(UpslopeError, match=r"learner 23 .* at update 5 \(1 of 40"):
            run(learners, keys(40), updates=7, every=3)

    @pytest.mark.parametrize(("count", "size"), [(1, 1), (8, 8), (17, 17), (100, 10), (500, 10), (96, 16), (40, 10)])
    def test_how_many_take_their_steps_side_by_side(self, count, size):
        assert block_size(walks(0.0), count) == size


class TestDevices:
    @pytest.mark.parametrize(("learners", "on_two"), [(1, 1), (2, 2), (3, 2), (200, 2)])
    def test_a_device_that_only_padding_would_use_is_left_out(self, learners, on_two):
        assert CompiledEngine().device_count(learners) == on_two
        assert CompiledEngine().mesh(walks(0.0), learners).devices.shape == (on_two, 1)

    def test_on_more_devices_as_few_as_share_the_load_as_well(self, monkeypatch):
        monkeypatch.setattr(jax, "local_devices", lambda: list(range(4)))
        counts = [CompiledEngine().device_count(learners) for learners in (1, 2, 3, 4, 5, 6, 8, 9)]
        assert counts == [1, 2, 3, 4, 3, 3, 4, 3]

    def test_one_learner_is_computed_once(self):
        outcome = run(walks([1.0]), keys(1), updates=7, every=3)
        assert outcome.flat_states.place.shape == (1,)
        assert len(outcome.flat_states.place.sharding.device_set) == 1

    def test_padding_of_a_batch_is_dropped_nowhere_but_at_the_end(self):
        assert run(walks([0.0, 1.0, 2.0]), keys(3), updates=1, every=1).flat_states.place.shape == (4,)


class TestTurns:
    def test_learners_in_turn_take_the_very_steps_of_learners_side_by_side(self):
        together = run(walks(DRIFTS), keys(3), updates=7, every=3)
        alone = run(walks(DRIFTS, in_turns=True), keys(3), updates=7, every=3)
        np.testing.assert_allclose(alone.reports["return"], together.reports["return"], rtol=1e-6)
        np.testing.assert_array_equal(alone.metrics["step"], together.metrics["step"])

    def test_settings_without_a_batch_axis_are_shared_by_all_in_turn_too(self):
        shared = eqx.tree_at(lambda walk: walk.drift, walks(DRIFTS, in_turns=True), jnp.asarray(4.0))
        np.testing.assert_allclose(run(shared, keys(3), updates=7, every=3).states.place, 28, atol=2)

    def test_learners_on_maps_take_turns_and_others_do_not(self):
        family, poles = obstacle_maps(), cartpoles()
        on_map = DQN(family, family.sample(jax.random.key(0)), None)
        on_pole = DQN(poles, poles.sample(jax.random.key(0)), None)
        assert (on_map.takes_turns, on_pole.takes_turns) == (True, False)


class TestDeterminism:
    def test_equal_keys_give_identical_bits(self):
        first, second = walk(), walk()
        assert_trees_identical(first.states, second.states)
        assert_trees_identical(first.reports, second.reports)

    def test_other_keys_give_other_outcomes(self):
        assert not np.array_equal(walk(seed=0).states.place, walk(seed=1).states.place)

    def test_reporting_more_often_changes_nothing(self):
        assert_trees_identical(walk(every=1).states, walk(every=7).states)


class TestCompiling:
    def test_chunks_of_any_length_share_one_program(self):
        first = run(walks([0.0] * 10), keys(10), updates=9, every=4)  # chunks of 0, 4, 4 and 1 steps
        again = run(walks([1.0] * 10), keys(10, seed=1), updates=50, every=7)
        assert first.programs > 0
        assert again.programs == 0
        assert again.seconds_compiling < first.seconds_compiling

    def test_seconds_are_counted_once_where_compiling_overlaps(self):
        # From 0 to 3 with one piece inside another, and from 5 to 6.
        assert CompileClock([(5.0, 6.0), (0.0, 2.0), (0.5, 1.0), (1.0, 3.0)]).seconds == 4.0
        assert CompileClock().seconds == 0.0


class TestObservers:
    def test_they_are_notified_of_everything_in_order(self):
        one, other = Memory(), Memory()
        outcome = walk(title="a walk", session=Session([one, other]))
        assert one.calls[0] == ("begin", "a walk", 7, 3)
        assert [call[:2] for call in one.calls[1:-1]] == [("record", mark) for mark in (0, 3, 6, 7)]
        assert one.calls[-1] == ("end",)
        for index, (_, _, returns, metrics) in enumerate(one.calls[1:-1]):
            np.testing.assert_array_equal(returns, outcome.reports["return"][:, index])
            np.testing.assert_array_equal(metrics["step"], outcome.metrics["step"][:, index])
        assert [call[0] for call in other.calls] == [call[0] for call in one.calls]

    def test_they_hear_of_the_end_of_a_run_that_fails(self):
        observer = Memory()
        with pytest.raises(UpslopeError):
            run(walks(DRIFTS, breaks_at=2), keys(3), updates=7, every=3, session=Session([observer]))
        assert observer.calls[-1] == ("end",), "or a progress bar stays on the terminal, and files stay open"


class TestDivergence:
    def test_a_metric_that_is_not_finite_stops_the_run(self):
        learners = walks(DRIFTS, breaks_at=5)
        with pytest.raises(UpslopeError, match=r"step of learner 0 is not a finite number at update 5 \(3 of 3"):
            run(learners, keys(3), updates=7, every=3)

    def test_the_learner_at_fault_is_named(self):
        learners = stack([walks(0.0), walks(0.0, breaks_at=1), walks(0.0)])
        with pytest.raises(UpslopeError, match=r"learner 1 .* at update 1 \(1 of 3"):
            run(learners, keys(3), updates=7, every=3)

    def test_it_goes_on_where_that_is_allowed(self):
        outcome = run(walks(DRIFTS, breaks_at=5), keys(3), updates=7, every=3, allow_divergence=True)
        np.testing.assert_array_equal(np.isnan(outcome.metrics["step"][0]), [False, False, True, False])
        assert outcome.states.steps.tolist() == [7, 7, 7]

    @pytest.mark.parametrize(("updates", "every"), [(0, 1), (1, 0), (-1, 1)])
    def test_less_than_one_update_can_t_be_run(self, updates, every):
        with pytest.raises(UpslopeError, match="give at least 1"):
            walk(updates=updates, every=every)


def test_states_given_to_observers_are_plain_numpy():
    observer = Memory()
    walk(session=Session([observer]))
    assert all(isinstance(call[2], np.ndarray) for call in observer.calls[1:-1])
    assert not any(isinstance(call[2], jnp.ndarray) for call in observer.calls[1:-1])
