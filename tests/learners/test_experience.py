"""A learner's experience of one task: raw rewards, F stored separately, and episodes that continue across updates."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.probes import ACTIONS, DISCRETE, discrete_family, table_potential, truncation_only, two_steps
from support.scores import Scores
from upslope.learners import lookups
from upslope.learners.experience import Experience, greedy_return
from upslope.learners.lookups import BestTable
from upslope.learners.policies import EpsilonGreedy
from upslope.learners.shaping import not_policy_invariant, potential_based
from upslope.networks.q_network import QNetwork
from upslope.tasks import cartpoles, obstacle_maps

FAMILY = discrete_family()
POTENTIAL = table_potential(2.0, -3.0)
RANDOM = EpsilonGreedy(Scores(jnp.flip, ACTIONS), 1.0)


def experience(shaping=None, *, task=None, chunks=(6, 6)):
    """Twelve steps of random actions, collected in chunks."""

    def take(key, task):
        keys = jax.random.split(key, 1 + len(chunks))
        remembered = Experience.start(keys[0], FAMILY, task, 12, shaping)
        for steps, key in zip(chunks, keys[1:], strict=True):
            remembered, _ = remembered.extend(key, FAMILY, task, RANDOM, steps, shaping)
        return remembered

    return jax.jit(take)(jax.random.key(0), two_steps() if task is None else task)


class TestRecords:
    def test_rewards_stay_raw_whatever_the_shaping(self):
        raw, shaped = experience(), experience(potential_based(POTENTIAL))
        np.testing.assert_array_equal(shaped.replay.data.transition.reward, raw.replay.data.transition.reward)
        assert set(np.asarray(raw.replay.data.transition.reward).tolist()) == {0.0, 1.0}

    def test_f_is_stored_next_to_them(self):
        data = experience(potential_based(POTENTIAL)).replay.data
        first = np.asarray(data.transition.obs[:, 0] == 1)
        # From the first place 0.8·(−3) − 2; from the second, where the episode ends, −(−3).
        np.testing.assert_allclose(data.added, np.where(first, -4.4, 3.0), rtol=1e-6)
        assert 0 < first.sum() < len(first)

    def test_f_that_is_not_invariant_counts_the_terminal_potential(self):
        data = experience(not_policy_invariant(POTENTIAL, FAMILY.gamma)).replay.data
        second = np.asarray(data.transition.obs[:, 1] == 1)
        np.testing.assert_allclose(np.asarray(data.added)[second], 0.8 * 2 + 3, rtol=1e-6)

    def test_without_shaping_there_is_no_f(self):
        assert experience().replay.data.added is None

    def test_samples_come_from_the_records(self):
        sample = experience(potential_based(POTENTIAL)).sample(jax.random.key(0), 50)
        first = np.asarray(sample.transition.obs[:, 0] == 1)
        np.testing.assert_allclose(sample.added, np.where(first, -4.4, 3.0), rtol=1e-6)


class TestContinuation:
    @pytest.mark.parametrize("chunks", [(12,), (1, 1, 3, 7)])
    def test_an_episode_continues_in_the_next_update(self, chunks):
        # Two-step episodes: first place, second place, first place, … however the twelve steps are split.
        data = experience(chunks=chunks).replay.data
        np.testing.assert_array_equal(data.transition.obs[:, 1], [0, 1] * 6)

    def test_truncation_keeps_the_discount(self):
        data = experience(task=truncation_only()).replay.data
        np.testing.assert_allclose(data.transition.discount, FAMILY.gamma)


@pytest.mark.parametrize("name", [name for name, probe in DISCRETE.items() if probe[2] is not None])
def test_greedy_return_is_the_mean_raw_return(name):
    task, q, expected = DISCRETE[name]
    table = jnp.asarray(q)

    def optimal(key, obs):
        return jnp.argmax(obs @ jnp.nan_to_num(table), axis=-1)

    assert float(greedy_return(jax.random.key(0), FAMILY, task, optimal, 5)) == expected


class TestTables:
    """The best actions of a finite task, computed once for all of its states: the same steps."""

    MAPS = obstacle_maps()

    @pytest.mark.parametrize(("steps", "tables"), [(22, 1), pytest.param(21, 0, marks=pytest.mark.slow)])
    def test_the_same_steps_as_with_the_network(self, steps, tables, monkeypatch):
        """Evaluating all 64 states together is cheaper than 22 of them one by one."""
        task, network = self.MAPS.sample(jax.random.key(1)), QNetwork(jax.random.key(2), (8, 8, 4), 4, (8, 8))
        remembered = Experience.start(jax.random.key(3), self.MAPS, task, 32)
        policy = EpsilonGreedy(network, 0.3)
        created = []
        monkeypatch.setattr(lookups, "BestTable", lambda *table: created.append(table) or BestTable(*table))

        def act(key):
            return remembered.act(key, self.MAPS, task, policy, steps)[1]

        def plainly(key):
            alone = jax.tree.map(lambda leaf: leaf[None], task)
            return self.MAPS.collect(key, alone, remembered.running, policy, steps)[1]

        actual, expected = jax.jit(act)(jax.random.key(4)), jax.jit(plainly)(jax.random.key(4))
        for ours, theirs in zip(jax.tree.leaves(actual), jax.tree.leaves(expected), strict=True):
            np.testing.assert_array_equal(ours, theirs[0])
        assert len(created) == tables
        assert len(set(np.asarray(actual.action).tolist())) > 1

    def test_a_policy_is_unchanged_where_states_cannot_be_listed(self):
        poles = cartpoles()
        policy = EpsilonGreedy(QNetwork(jax.random.key(2), 4, 2, (8,)), 0.3)
        assert lookups.policy_with_table(poles, poles.sample(jax.random.key(1)), policy, 1000) is policy
