"""Every learner on host families, through the same loop: the same phases, finite numbers, checkpoints, learning."""

import dataclasses

import gymnasium as gym
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import upslope
from support import host
from support.comparing import assert_trees_close
from upslope import GymnasiumTasks, MetaTrainingConfig
from upslope.adaptation.algorithm2 import AdaptationConfig
from upslope.adaptation.fine_tuning import FineTuning
from upslope.errors import UpslopeError
from upslope.learners.ddpg import DDPGConfig
from upslope.learners.dqn import DQN, DQNConfig
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.posteriors import NetworkPosterior
from upslope.run.checkpoints import Checkpoints
from upslope.run.engines import HostEngine
from upslope.run.loop import broadcast, run
from upslope.run.session import Session

SMALL = MetaTrainingConfig(
    iterations=4, tasks=3, steps_per_task=20, posterior=NetworkPosterior(batch_size=16), hidden=(8, 8),
    outer_updates=2, snapshot_every=2,
    evaluation_tasks=2, evaluation_episodes=1,
)  # fmt: skip
DQN_SMALL = DQNConfig(hidden=(8,), batch_size=8, warmup_steps=16, replay_capacity=64, evaluation_episodes=1)


def poles(make=host.short_pole):
    return GymnasiumTasks(host.length, make, 0.98, name="cartpole", observation_scale=host.SCALE)


#: One family for all tests, so that they share compiled programs.
FAMILY = poles()


@pytest.fixture(scope="module")
def prior():
    return upslope.meta_train(FAMILY, seed=0, config=SMALL)


def test_algorithm_1(prior):
    assert prior.trained_on.family == "cartpole"
    assert prior.trained_on.settings["iteration"] in (2, 4)
    assert 1 <= prior.trained_on.settings["return_on_training_tasks"] <= 12
    again = upslope.meta_train(FAMILY, seed=0, config=SMALL)
    assert prior.to_numpy() == again.to_numpy()
    assert prior.to_numpy() != upslope.meta_train(FAMILY, seed=1, config=SMALL).to_numpy()


@pytest.mark.parametrize(
    "rule", [None, pytest.param(FineTuning(), marks=pytest.mark.slow)], ids=["algorithm 2", "MAML"]
)
@pytest.mark.slow
def test_adaptation(prior, rule):
    family = FAMILY
    config = AdaptationConfig(batch_size=8, steps_per_update=10, evaluation_episodes=1, replay_capacity=64)
    task = family.sample(jax.random.key(5))
    result = upslope.adapt(family, task, prior, updates=3, rule=rule, config=config)
    assert result.returns.shape == (4,)
    assert np.all((result.returns >= 1) & (result.returns <= 12))
    assert result.posterior.to_numpy() != prior.to_numpy()


@pytest.mark.parametrize("shaped", [pytest.param(False, marks=pytest.mark.slow), True])
def test_dqn(prior, shaped):
    family = FAMILY
    task = family.sample(jax.random.key(5))
    result = upslope.train(family, task, prior if shaped else None, updates=20, every=10, config=DQN_SMALL)
    assert result.returns.shape == (3,)
    assert np.all(result.metrics["td_loss"][1:] > 0)
    assert bool(np.any(result.metrics["shaped_reward"][1:] != 1.0)) == shaped
    np.testing.assert_array_equal(result.metrics["reward"][1:], 1.0)


@pytest.mark.slow
def test_ddpg(prior):
    family = poles(host.pushed_pole)
    config = DDPGConfig(hidden=(8,), batch_size=8, warmup_steps=16, replay_capacity=64, evaluation_episodes=1)
    result = upslope.train(family, family.sample(jax.random.key(5)), prior, updates=20, every=10, config=config)
    assert result.returns.shape == (3,)
    assert np.all(np.isfinite(result.metrics["critic_loss"]))


@pytest.mark.slow
def test_several_learners_take_turns_without_affecting_each_other():
    family = FAMILY
    tasks = family.sample_many(jax.random.key(5), 2)
    keys = jax.random.split(jax.random.key(0), 2)
    settings = {"updates": 6, "every": 3}
    both = run(DQN(family, tasks, None, DQN_SMALL), keys, **settings)
    for index in range(2):
        alone = run(DQN(family, tasks[index : index + 1], None, DQN_SMALL), keys[index : index + 1], **settings)
        np.testing.assert_array_equal(both.reports["return"][index], alone.reports["return"][0])
        assert_trees_close(
            jax.tree.map(lambda leaf, i=index: leaf[i], both.states.network),
            jax.tree.map(lambda leaf: leaf[0], alone.states.network),
        )


def test_a_chunk_equals_its_parts():
    learners = broadcast(MetaTraining(FAMILY, SMALL), (1,))
    keys = jax.random.key(0)[None]
    ends = [run(learners, keys, updates=4, every=every).states.theta for every in (4, 2)]
    assert_trees_close(ends[0], ends[1])


@pytest.mark.slow
def test_on_the_host_the_network_of_one_iteration_ago_acts():
    learner = MetaTraining(FAMILY, SMALL)
    before = learner.init(jax.random.key(0))
    after, _ = learner.step(before)
    assert_trees_close(before.acting, before.theta)
    assert_trees_close(after.acting, before.theta)
    moved = jax.tree.map(lambda new, old: float(jnp.abs(new - old).max()), after.theta, after.acting)
    assert max(jax.tree.leaves(moved)) > 0


def test_gathering_ahead_equals_gathering_in_the_next_step():
    learner = MetaTraining(FAMILY, SMALL)
    state, _ = learner.step(learner.init(jax.random.key(0)))
    ahead = learner.gather_ahead(state)
    following, _ = learner.step(state)
    for actual, expected in zip(ahead(), learner.gather(following), strict=True):
        np.testing.assert_array_equal(actual, expected)


def test_in_compiled_environments_the_newest_network_acts():
    learner = MetaTraining(upslope.cartpoles(), SMALL)
    after, _ = jax.jit(learner.step)(learner.init(jax.random.key(0)))
    assert_trees_close(after.acting, after.theta)


@pytest.mark.slow
def test_worker_processes_give_the_same_learning():
    family = GymnasiumTasks(
        host.length, host.short_pole, 0.98, name="cartpole", observation_scale=host.SCALE, mode="async"
    )
    few = dataclasses.replace(SMALL, iterations=2, tasks=2, snapshot_every=1, evaluation_tasks=2)
    priors = [upslope.meta_train(one, seed=0, config=few) for one in (FAMILY, family)]
    assert priors[0].to_numpy() == priors[1].to_numpy()


@pytest.mark.parametrize("family", [poles(host.pushed_pole), upslope.cartpoles(continuous=True)], ids=["host", "JAX"])
def test_algorithm_1_needs_discrete_actions(family):
    with pytest.raises(UpslopeError, match=r"continuous actions.*discrete ones"):
        upslope.meta_train(family, config=SMALL)


def test_a_potential_that_jax_cannot_trace_raises_a_clear_error():
    with pytest.raises(UpslopeError, match=r"write it with jax\.numpy") as caught:
        upslope.train(FAMILY, FAMILY.sample(jax.random.key(0)), lambda obs: -abs(float(obs[2])), updates=1, every=1)
    assert "\n" not in str(caught.value)


def test_shapes_are_known_without_an_environment():
    lengths = []

    def make(length):
        lengths.append(length)
        return host.short_pole(length)

    learners = broadcast(MetaTraining(poles(make), SMALL), (2,))
    assert len(lengths) == 1, "the one that showed its spaces"
    states, totals, report = HostEngine().shapes(learners, jax.random.split(jax.random.key(0), 2))
    assert states.theta.value_head.weight.shape == (2, 1, 8)
    assert totals["outer_loss"].shape == (2,)
    assert report["return"].shape == (2,)
    assert len(lengths) == 1


def test_a_resumed_run_starts_new_episodes_and_warns(tmp_path):
    learners = broadcast(DQN(FAMILY, jnp.array([1, 2], jnp.uint32), None, DQN_SMALL), (1,))
    keys = jax.random.key(0)[None]
    saving = Session(checkpoints=Checkpoints(tmp_path, every_updates=4))
    whole = run(learners, keys, updates=12, every=4, session=saving)
    newest = sorted((tmp_path / "checkpoints").rglob("*.safetensors"))
    newest[-1].unlink()
    resuming = Session(checkpoints=Checkpoints(tmp_path, every_updates=4, resume=True))
    with pytest.warns(UserWarning, match="new ones start"):
        resumed = run(learners, keys, updates=12, every=4, session=resuming)
    np.testing.assert_array_equal(resumed.reports["return"][0, :3], whole.reports["return"][0, :3])
    assert int(resumed.states.experience.replay.added[0]) == 16 + 12


def test_failures_on_the_host_are_named():
    open_poles = set()

    class NaNs(gym.RewardWrapper):
        def reset(self, **settings):
            open_poles.add(self)
            return super().reset(**settings)

        def reward(self, reward):
            return float("nan")

        def close(self):
            open_poles.discard(self)

    family = poles(
        lambda length: NaNs(host.short_pole(length))
    )  # the same settings as the other tests, to reuse their programs
    with pytest.raises(UpslopeError, match="DQN: reward of learner 0 is not a finite number at update 1"):
        upslope.train(family, family.sample(jax.random.key(0)), updates=3, every=1, config=DQN_SMALL)
    assert not open_poles, "environments are closed whatever happens"


@pytest.mark.slow
def test_a_prior_meta_trained_on_gymnasium_s_own_environments_learns_to_balance():
    family = poles(host.pole)
    returns = []
    for seed in range(5):
        prior = upslope.meta_train(family, seed=seed, config=MetaTrainingConfig(iterations=150))
        returns.append(prior.trained_on.settings["return_on_training_tasks"])
    assert np.median(returns) > 100, returns


def test_a_setting_of_the_simulator_is_not_a_task():
    with pytest.raises(UpslopeError, match=r"what family\.sample\(key\) returns.*sample\(rng\) returns it"):
        upslope.train(FAMILY, 1.0, updates=2, every=1, config=DQN_SMALL)
