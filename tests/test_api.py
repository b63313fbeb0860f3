"""The verbs: what they take, what they return, and how they refuse bad arguments."""

import inspect
import pickle
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import upslope
from upslope import (
    AdaptationConfig,
    DDPGConfig,
    DQNConfig,
    FineTuning,
    MetaTrainingConfig,
    Prior,
    Session,
    UpslopeError,
    adapt,
    cartpoles,
    grid_games,
    meta_train,
    train,
)
from upslope.learners import LEARNERS, suited_to
from upslope.learners.agent import Agent, record
from upslope.learners.dqn import DQN, for_maps
from upslope.networks.dueling import DuelingQ
from upslope.priors.prior import trained_on
from upslope.priors.shaping_by import check_potential
from upslope.tasks.family import as_key

POLES = cartpoles()
TASK = POLES.sample(jax.random.key(0))
SMALL = DQNConfig(batch_size=4, warmup_steps=8, replay_capacity=64, evaluation_episodes=1)


def prior_of(family=POLES) -> Prior:
    network = DuelingQ(jax.random.key(0), 4, 2, (8,), family.observation_scale)
    return Prior(network, trained_on(family, network, 0, {}))


@pytest.mark.parametrize(
    ("potential", "words"),
    [
        (lambda obs: obs, r"returned \(4,\) for one observation"),
        (lambda obs: obs[:1], r"returned \(1,\) for one observation"),
        (lambda obs: "high", "returned"),
        (lambda obs: jnp.log(obs[0]), "not finite at the zero observation"),
        (lambda obs: jnp.nan * obs[0], "not finite at the zero observation"),
        (lambda obs: obs[0] if obs[0] > 0 else 0.0, "failed on one observation"),
        (lambda obs: obs["angle"], "failed on one observation"),
    ],
)
def test_a_bad_potential_is_refused(potential, words: str) -> None:
    with pytest.raises(UpslopeError, match=words):
        train(POLES, TASK, potential, config=SMALL)


def test_a_plain_function_and_a_bound_method_are_potentials() -> None:
    obs = jnp.array([0.1, 0.2, -0.3, 0.4])
    assert float(check_potential(lambda obs: -jnp.abs(obs[2]), POLES)(obs)) == pytest.approx(-0.3)
    network = prior_of().network
    assert float(check_potential(network.value, POLES)(obs)) == pytest.approx(float(network.value(obs)))


@pytest.mark.slow
def test_training_reports_raw_returns_whatever_the_potential() -> None:
    """The first report comes before any update: the same networks and episodes, so the same returns."""
    raw = train(POLES, TASK, None, updates=4, every=2, config=SMALL)
    shaped = train(POLES, TASK, lambda obs: 100.0 * obs[0], updates=4, every=2, config=SMALL)
    np.testing.assert_array_equal(raw.updates, [0, 2, 4])
    assert raw.returns.shape == raw.metrics["td_loss"].shape == (3,)
    assert raw.returns[0] == shaped.returns[0]
    assert raw.metrics["shaped_reward"][1] == pytest.approx(1.0)
    assert shaped.metrics["shaped_reward"][1] != pytest.approx(1.0)


@pytest.mark.slow
def test_a_potential_that_is_not_finite_somewhere_stops_the_run() -> None:
    with pytest.raises(UpslopeError, match="not a finite number at update"):
        train(POLES, TASK, lambda obs: jnp.where(obs[2] == 0, 0.0, jnp.inf), updates=4, every=2, config=SMALL)


def test_a_prior_of_other_tasks_is_refused() -> None:
    with pytest.raises(UpslopeError, match=r"gamma is 0.98 in the prior and 0.9 in the tasks"):
        train(cartpoles(gamma=0.9), TASK, prior_of(), config=SMALL)


@pytest.mark.parametrize(("config", "family"), [(DDPGConfig(), POLES), (SMALL, cartpoles(continuous=True))])
def test_a_learner_for_other_actions_is_refused(config, family) -> None:
    kind = family.actions.kind
    with pytest.raises(UpslopeError, match=f"needs {config.actions} actions, but the tasks of 'cartpole' have {kind}"):
        train(family, TASK, config=config)


def test_the_default_learner_suits_the_family() -> None:
    assert suited_to(POLES) == DQNConfig()
    assert suited_to(cartpoles(continuous=True)) == DDPGConfig()
    assert suited_to(grid_games()) == for_maps() != DQNConfig()
    assert suited_to(grid_games(flat=True)) == DQNConfig()


def test_two_learners_for_one_kind_of_action(monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    """A new learner is a settings class and its entry in the table; its agents are saved and loaded by its name."""

    @dataclass(frozen=True)
    class PatientConfig(DQNConfig):
        name: ClassVar[str] = "patient"

        target_rate: float = 0.001

    monkeypatch.setitem(LEARNERS, "patient", PatientConfig)
    config = PatientConfig(batch_size=4, warmup_steps=8, replay_capacity=64, evaluation_episodes=1)
    about = record(config, POLES, 3)
    assert (about.learner, about.settings["target_rate"]) == ("patient", 0.001)
    network = config.policy_network(jax.random.key(0), (4,), 2, POLES.observation_scale)
    Agent(network, about).save(tmp_path / "agent.safetensors")
    assert Agent.load(tmp_path / "agent.safetensors").trained_on == about
    assert suited_to(POLES) == DQNConfig()
    assert config.build(POLES, TASK, None) == DQN(POLES, TASK, None, config)


@pytest.fixture(scope="module", params=["discrete", pytest.param("continuous", marks=pytest.mark.slow)])
def result(request) -> upslope.TrainingResult:
    if request.param == "discrete":
        return train(POLES, TASK, updates=3, every=2, seed=4, config=SMALL)
    config = DDPGConfig(batch_size=4, warmup_steps=8, replay_capacity=64, evaluation_episodes=1)
    return train(cartpoles(continuous=True), TASK, updates=3, every=2, config=config)


class TestAgents:
    """Of `train`."""

    def test_they_act_greedily(self, result):
        obs = np.random.default_rng(0).normal(scale=10, size=(200, 4)).astype(np.float32)
        expected = np.asarray(jax.vmap(result.agent.network.best)(obs))
        actions = result.agent.act(obs)
        assert isinstance(actions, np.ndarray)
        np.testing.assert_allclose(actions, expected, atol=1e-6)
        np.testing.assert_allclose(result.agent.act(obs[7]), expected[7], atol=1e-6)
        assert len(np.unique(actions)) > 1

    def test_one_action_is_an_int_or_a_vector(self, result):
        action = result.agent.act([0.0, 0.1, 0.05, -0.2])
        if result.agent.trained_on.action_kind == "discrete":
            assert type(action) is int
        else:
            assert action.shape == (1,)
            assert np.abs(action).max() <= 1

    def test_they_refuse_other_observations(self, result):
        with pytest.raises(UpslopeError, match=r"have shape \[3\]: give one of shape \[4\], or a batch \[n, 4\]"):
            result.agent.act([0.0, 0.1, 0.2])
        with pytest.raises(UpslopeError, match=r"have shape \[2, 2, 4\]"):
            result.agent.act(np.zeros((2, 2, 4)))

    def test_files_and_pickles_act_alike(self, result, tmp_path):
        obs = np.random.default_rng(0).normal(size=(50, 4))
        result.agent.save(tmp_path / "agents" / "agent.safetensors")
        loaded = upslope.Agent.load(tmp_path / "agents" / "agent.safetensors")
        np.testing.assert_array_equal(loaded.act(obs), result.agent.act(obs))
        assert loaded.trained_on == result.agent.trained_on
        np.testing.assert_array_equal(pickle.loads(pickle.dumps(loaded)).act(obs), result.agent.act(obs))


class TestPriors:
    def test_the_potential_is_the_value_head(self):
        prior = prior_of()
        obs = jnp.linspace(-1, 1, 12).reshape(3, 4)
        expected = [float(prior.network.value(one)) for one in obs]
        np.testing.assert_allclose([prior(one) for one in obs], expected, rtol=1e-6)
        np.testing.assert_allclose(prior(obs), expected, rtol=1e-6)
        np.testing.assert_allclose(jax.jit(prior)(obs), expected, rtol=1e-6)
        np.testing.assert_allclose(prior.values(obs), expected, rtol=1e-6)
        assert len(set(expected)) == 3
        assert prior.gamma == replace(prior.trained_on).gamma == 0.98

    def test_they_act_greedily(self):
        prior = prior_of()
        obs = np.random.default_rng(0).normal(size=(200, 4)).astype(np.float32)
        expected = np.asarray(jax.vmap(prior.network.best)(obs))
        np.testing.assert_array_equal(prior.act(obs), expected)
        assert [prior.act(one) for one in obs[:20]] == expected[:20].tolist()
        assert set(expected.tolist()) == {0, 1}

    def test_they_refuse_other_observations(self):
        for use in (prior_of(), prior_of().act):
            with pytest.raises(UpslopeError, match=r"have shape \[5\]: give one of shape \[4\]"):
                use(np.zeros(5))

    def test_a_used_prior_can_be_pickled(self):
        prior = prior_of()
        action = prior.act(np.ones(4))
        again = pickle.loads(pickle.dumps(prior))
        assert again.act(np.ones(4)) == action
        assert again.to_numpy() == prior.to_numpy()


FEW = MetaTrainingConfig(
    iterations=4, tasks=2, steps_per_task=8, hidden=(4,), outer_updates=1, snapshot_every=2, evaluation_tasks=2,
    evaluation_episodes=1,
).with_posterior(batch_size=4)  # fmt: skip


def test_meta_training_returns_its_learning_curve_and_warns(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    trouble = SimpleNamespace(warnings=lambda: ["The potential is flat."])
    monkeypatch.setattr("upslope.api.signs", lambda *measured: trouble)
    with pytest.warns(upslope.PriorWarning, match=r"The potential is flat\."):
        prior = meta_train(POLES, config=FEW)
    np.testing.assert_array_equal(prior.curve.updates, [0, 2, 4])
    assert prior.curve.returns.shape == (3,)
    best = prior.curve.updates.tolist().index(prior.trained_on.settings["iteration"])
    assert prior.curve.returns[best] == prior.trained_on.settings["return_on_training_tasks"]
    assert prior.curve.metrics["outer_loss"].shape == (3,)
    prior.save(tmp_path / "prior.safetensors")
    assert Prior.load(tmp_path / "prior.safetensors").curve is None


@pytest.mark.slow
def test_adaptation_returns_a_posterior_that_acts() -> None:
    config = AdaptationConfig(batch_size=8, replay_capacity=64, steps_per_update=8, evaluation_episodes=1)
    prior = prior_of()
    result = adapt(POLES, TASK, prior, updates=2, rule=FineTuning(), step_size=0.1, config=config)
    np.testing.assert_array_equal(result.updates, [0, 1, 2])
    assert result.returns.shape == result.metrics["value_change"].shape == (3,)
    assert result.posterior.to_numpy() != prior.to_numpy()
    obs = np.random.default_rng(0).normal(size=(20, 4)).astype(np.float32)
    np.testing.assert_array_equal(result.agent.act(obs), jax.vmap(result.posterior.network.best)(obs))


@pytest.mark.parametrize(
    ("verb", "arguments", "settings", "words"),
    [
        (adapt, lambda: (prior_of(), POLES, TASK), {}, r"family of adapt must be.*adapt\(family, task, prior"),
        (adapt, lambda: (POLES, TASK, None), {}, "prior of adapt must be of the type Prior"),
        (adapt, lambda: (POLES, TASK, prior_of()), {"step_size": -1.0}, "step size is -1.0"),
        (adapt, lambda: (POLES, TASK, prior_of()), {"step_size": float("nan")}, "step size is nan"),
        (adapt, lambda: (POLES, TASK, prior_of()), {"config": SMALL}, "of the type AdaptationConfig, but DQNConfig"),
        (meta_train, lambda: (POLES,), {"config": {"iterations": 3}}, "of the type MetaTrainingConfig, but dict"),
        (meta_train, lambda: ("cartpole",), {}, "of the type AbstractFamily, but str"),
        (train, lambda: (POLES, TASK), {"config": {"batch_size": 3}}, "of the type AbstractLearnerConfig, but dict"),
        (DQNConfig, tuple, {"batch_size": 0}, "batch_size is 0"),
        (AdaptationConfig, tuple, {"epsilon": 1.5}, "epsilon is 1.5"),
        (as_key, lambda: ("seed",), {}, "'seed' was given"),
    ],
)
def test_bad_arguments(verb, arguments, settings, words) -> None:
    with pytest.raises(UpslopeError, match=words):
        inspect.unwrap(verb)(*arguments(), **settings)  # users have no type checks at run time


def test_an_integer_draws_the_task_of_its_key() -> None:
    assert float(POLES.sample(3).length) == float(POLES.sample(jax.random.key(3)).length)


class TestProgress:
    """A bar on standard error: where somebody can watch, or where it is asked for."""

    def bars(self, capsys, **arguments) -> int:
        train(POLES, TASK, updates=2, every=2, config=SMALL, **arguments)
        return capsys.readouterr().err.count("DQN")

    @pytest.mark.parametrize("is_terminal", [False, True])
    def test_by_default_a_terminal_decides(self, is_terminal, monkeypatch, capsys):
        monkeypatch.setattr("upslope.run.session.has_display", lambda: is_terminal)
        assert (self.bars(capsys) > 0) == is_terminal

    def test_it_can_be_turned_off_and_on(self, monkeypatch, capsys):
        assert self.bars(capsys, progress=True) > 0
        monkeypatch.setattr("upslope.run.session.has_display", lambda: True)
        assert self.bars(capsys, progress=False) == 0

    def test_a_session_with_observers_gets_no_second_bar(self, monkeypatch, capsys):
        monkeypatch.setattr("upslope.run.session.has_display", lambda: True)

        class Silent:
            def begin(self, title, updates, learners): ...
            def record(self, update, returns, metrics, *, at): ...
            def end(self): ...

        assert self.bars(capsys, session=Session(observers=(Silent(),))) == 0


class TestTheFace:
    def test_it_is_what_dir_shows(self):
        names = dir(upslope)
        assert {"train", "Agent", "DQNConfig", "AdaptationConfig", "FineTuning", "__version__"} <= set(names)
        assert not {"Any", "TYPE_CHECKING", "import_module", "version"} & set(names)
        for name in names:
            assert getattr(upslope, name) is not None
        with pytest.raises(AttributeError, match="no attribute 'trian'"):
            upslope.trian  # noqa: B018

    def test_reprs_fit_on_two_lines(self):
        result = train(POLES, TASK, updates=2, every=2, config=SMALL)
        shown = [result, result.agent, result.curve, prior_of(), POLES, grid_games(), cartpoles(continuous=True)]
        for one in shown:
            assert len(repr(one).splitlines()) <= 2
            assert max(map(len, repr(one).splitlines())) <= 120
        assert repr(POLES) == "JaxTasks('cartpole', gamma=0.98, observations [4], 2 discrete actions, 200 steps)"
        assert "dqn on 'cartpole'" in repr(result)
