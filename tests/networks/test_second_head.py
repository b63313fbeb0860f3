"""A second advantage head, registered in one line, goes through every algorithm and a file unchanged."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from support.batches import random_batch
from support.comparing import assert_trees_identical, largest
from support.levelled import LevelledHead, levelled, plain
from support.meta import TINY
from support.probes import ACTIONS, PLACES, choices, discrete_family
from upslope.adaptation.algorithm2 import Adaptation, AdaptationConfig, Algorithm2, advantage_step_loss
from upslope.adaptation.fine_tuning import FineTuning
from upslope.errors import DamagedFileError
from upslope.learners.lookups import dueling_table
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.networks.heads import HEADS
from upslope.priors.numpy_potential import NumpyPotential
from upslope.priors.prior import Prior, trained_on
from upslope.priors.prior_file import read_prior_file
from upslope.tasks import grid_games

FAMILY = discrete_family()
OBS = jnp.eye(PLACES)
BATCH = random_batch(3, leading=(12,))


@pytest.fixture
def registered(monkeypatch):
    monkeypatch.setitem(HEADS, LevelledHead.name, LevelledHead)


def rows(network, obs=OBS):
    """Q(s, ·) of a batch."""
    return np.asarray(jax.vmap(network)(obs))


class TestNetwork:
    network = levelled(7, 3, 4)
    many = 3 * jax.random.normal(jax.random.key(9), (50, 3))

    def test_value_is_exactly_the_best_action_value(self):
        np.testing.assert_array_equal(jax.vmap(self.network.value)(self.many), rows(self.network, self.many).max(-1))

    def test_every_reading_is_the_discrete_head_s(self):
        twin = plain(self.network)
        actions = jax.random.randint(jax.random.key(1), (50,), 0, 4)
        for name, others in (("q", (actions,)), ("advantage", (actions,)), ("highest_advantage", ()), ("__call__", ())):
            ours, theirs = (jax.vmap(getattr(net, name))(self.many, *others) for net in (self.network, twin))
            np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-5)
        np.testing.assert_array_equal(jax.vmap(self.network.best)(self.many), rows(self.network, self.many).argmax(-1))

    def test_numpy_acts_as_jax_does(self):
        found = self.network.numpy_best()(np.asarray(self.many))
        np.testing.assert_array_equal(found, jax.vmap(self.network.best)(self.many))
        assert len(set(found.tolist())) > 1

    def test_random_actions_are_uniform(self):
        drawn = self.network.random_actions(jax.random.key(0), 20_000)
        np.testing.assert_allclose(np.bincount(drawn, minlength=4) / 20_000, 0.25, atol=0.013)

    def test_a_table_of_every_state(self):
        maps = grid_games((3, 4), flat=True)
        task, network = maps.sample(jax.random.key(0)), levelled(0, maps.observation_shape[0], 4)
        table, observations = dueling_table(maps, task, network), maps.states.observe_all(task)
        np.testing.assert_allclose(rows(table, observations), rows(network, observations), rtol=1e-4, atol=1e-5)
        value = jax.vmap(table.value)(observations)
        np.testing.assert_array_equal(value, rows(table, observations).max(-1))


@pytest.mark.usefixtures("registered")
def test_algorithm_1_learns_what_it_learns_with_the_discrete_head():
    def after(head, convert):
        meta = MetaTraining(FAMILY, dataclasses.replace(TINY, head=head, outer_optimiser="sgd", outer_step_size=0.1))
        state = meta.init(jax.random.key(0))
        theta = convert(levelled(5))
        assert type(state.theta.advantage_head) is HEADS[head]
        state = dataclasses.replace(
            state, theta=theta, acting=theta, target=theta, average=theta, optimiser=meta.config.optimiser().init(theta)
        )
        step = jax.jit(meta.step)
        for _ in range(3):
            state, metrics = step(state)
        return state, metrics, jax.jit(meta.report)(state)

    ours, metrics, report = after("levelled", lambda network: network)
    theirs, expected, other_report = after("discrete", plain)
    assert float(metrics["outer_loss"]) == pytest.approx(float(expected["outer_loss"]), rel=1e-3)
    np.testing.assert_allclose(rows(ours.theta), rows(theirs.theta), rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(rows(ours.average), rows(theirs.average), rtol=1e-4, atol=1e-5)
    np.testing.assert_array_equal(jax.vmap(ours.theta.value)(OBS), rows(ours.theta).max(-1))
    assert np.abs(rows(ours.theta) - rows(levelled(5))).max() > 1e-3
    assert float(report["return"]) == float(other_report["return"])
    # Eq. 6 gives the level no gradient, and the torso none through it.
    moved = np.abs(ours.theta.advantage_head.bias - levelled(5).advantage_head.bias)
    assert moved[0] < 1e-6 < 1e-4 < moved[1:].max()


def test_maml_learns_what_it_learns_with_the_discrete_head():
    network, rule = levelled(0, 3), FineTuning(steps=2)
    ours, theirs = (rule.update(net, net, BATCH, jnp.asarray(0.05)) for net in (network, plain(network)))
    np.testing.assert_allclose(rows(ours, BATCH.obs), rows(theirs, BATCH.obs), rtol=1e-4, atol=1e-5)
    assert np.abs(rows(ours, BATCH.obs) - rows(network, BATCH.obs)).max() > 1e-2


class TestAlgorithm2:
    def test_equation_8_by_hand(self):
        """The level takes part in every step, each other output where its action was taken."""
        phi, prior = levelled(1, 3), levelled(0, 3)
        level = Algorithm2().level(prior)
        a, next_a = (
            jax.vmap(lambda obs: phi.advantage_head.each(phi.heads(obs)[1]) - level(obs))(obs)
            for obs in (BATCH.obs, BATCH.next_obs)
        )
        value, next_value = (jax.vmap(phi.value)(obs) for obs in (BATCH.obs, BATCH.next_obs))
        shaped = BATCH.reward + BATCH.discount * next_value - value
        errors = np.asarray(shaped + BATCH.discount * next_a.max(-1) - a[jnp.arange(12), BATCH.action])
        gradient = jax.grad(advantage_step_loss)(phi, phi, BATCH, level).advantage_head.bias
        taken = np.eye(ACTIONS)[np.asarray(BATCH.action)]
        pull = -2 * errors[:, None] * np.concatenate([np.ones((12, 1)), taken], axis=1)
        np.testing.assert_allclose(gradient, pull.mean(axis=0), rtol=1e-4, atol=1e-5)

    def test_it_adapts(self):
        prior = levelled(4)
        config = AdaptationConfig(batch_size=16, replay_capacity=200, steps_per_update=4, epsilon=0.5)
        learner = Adaptation(FAMILY, choices(), prior, jnp.asarray(0.1), Algorithm2(), config)
        state, step = (
            jax.jit(lambda key: learner.init(key))(jax.random.key(0)),
            jax.jit(lambda state: learner.step(state)),
        )
        for _ in range(300):
            state, metrics = step(state)
        # Q* of the probe: nothing or γ = 0.8, then 1 or −1; A starts as Q − V.
        level = np.asarray(jax.vmap(prior.highest_advantage)(OBS))[:, None]
        a = np.asarray(jax.vmap(lambda obs: state.phi.advantage_head.each(state.phi.heads(obs)[1]))(OBS)) - level
        np.testing.assert_allclose(jax.vmap(state.phi.value)(OBS), [0.8, 1.0], atol=0.05)
        np.testing.assert_allclose(a, [[-0.8, 0.0], [0.0, -2.0]], atol=0.05)
        assert float(metrics["value_change"]) > 0
        assert float(jax.jit(lambda state: learner.report(state))(state)["return"]) == 1.0


class TestFiles:
    @pytest.fixture
    @staticmethod
    def path(tmp_path):
        return tmp_path / "prior.safetensors"

    @staticmethod
    def saved(network, path):
        prior = Prior(network, trained_on(FAMILY, network, 3, {}))
        prior.save(path)
        return prior

    @pytest.mark.usefixtures("registered")
    def test_it_comes_back_bit_for_bit(self, path):
        prior = self.saved(levelled(), path)
        loaded = Prior.load(path)
        assert loaded.trained_on.head == "levelled"
        assert_trees_identical(loaded.network, prior.network)
        np.testing.assert_array_equal(rows(loaded.network), rows(prior.network))
        np.testing.assert_array_equal(loaded.values(OBS), rows(prior.network).max(-1))

    def test_its_potential_needs_no_head(self, path):
        prior = self.saved(levelled(), path)
        assert "levelled" not in HEADS
        potential = NumpyPotential.load(path)
        np.testing.assert_allclose(potential.values(np.asarray(OBS)), prior.values(OBS), rtol=1e-5)
        assert potential == prior.to_numpy()

    def test_an_unknown_head_is_a_damaged_file(self, path):
        self.saved(levelled(), path)
        with pytest.raises(DamagedFileError, match="advantage head 'levelled' is unknown") as caught:
            Prior.load(path)
        assert str(path) in str(caught.value)

    @pytest.mark.usefixtures("registered")
    def test_another_head_than_announced_is_a_damaged_file(self, path):
        network = levelled()
        about = dataclasses.replace(trained_on(FAMILY, network, 3, {}), head="discrete")
        Prior(network, about).save(path)
        with pytest.raises(DamagedFileError, match=r"advantage_head.* but the header announces"):
            Prior.load(path)

    def test_files_of_the_discrete_head_are_the_same_with_it_and_without(self, path, monkeypatch):
        network = plain(levelled())
        self.saved(network, path)
        before, arrays = read_prior_file(path)
        assert_trees_identical(Prior.load(path).network, network)
        monkeypatch.setitem(HEADS, LevelledHead.name, LevelledHead)
        self.saved(network, path.with_name("again.safetensors"))
        after, same = read_prior_file(path.with_name("again.safetensors"))
        assert after == before
        assert sorted(same) == sorted(arrays)
        assert all(np.array_equal(same[name], array) for name, array in arrays.items())
        assert Prior.load(path).trained_on.head == "discrete"
        assert_trees_identical(Prior.load(path).network, network)
        assert largest(network) > 0


def test_an_optimiser_step_keeps_the_head():
    network = levelled()
    gradient = jax.grad(lambda net: net.q(OBS[0], 1))(network)
    moved = optax.apply_updates(network, jax.tree.map(lambda leaf: -0.1 * leaf, gradient))
    assert type(moved.advantage_head) is LevelledHead
    assert largest(jax.tree.map(jnp.subtract, moved, network)) > 1e-3
