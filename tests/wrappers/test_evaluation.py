"""Potentials of every kind return plain floats: numpy, JAX, torch, priors; with and without a batch axis; bad ones."""

import gymnasium as gym
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.spaces import Box, Dict, Discrete, Text, Tuple

from upslope import UpslopeError
from upslope.wrappers.evaluation import Evaluator

BOX = Box(-10, 10, (4,), np.float32)
OBS = np.random.default_rng(0).normal(size=(4, 4)).astype(np.float32)  # a square batch: ambiguous
EXPECTED = -np.abs(OBS[:, 2]).astype(np.float64)


class Module:
    """Callable objects are potentials too."""

    def __call__(self, obs):
        return -abs(float(obs[2]))


POTENTIALS = {
    "numpy, one": lambda obs: -np.abs(obs[2]),
    "numpy, a column for one": lambda obs: -np.abs(obs[2:3]),
    "numpy, a batch": lambda obs: -np.abs(obs[:, 2]),
    "numpy, a column for a batch": lambda obs: -np.abs(obs[:, 2:3]),
    "numpy, either": lambda obs: -np.abs(obs[..., 2]),
    "jax, one": lambda obs: -jnp.abs(obs[2]),
    "jax, a batch": lambda obs: -jnp.abs(obs[:, 2]),
    "a Python float": lambda obs: -abs(float(obs[2])),
    "an object": Module(),
}


@pytest.mark.parametrize("name", POTENTIALS)
def test_every_kind_gives_the_same_numbers(name):
    evaluator = Evaluator(POTENTIALS[name], BOX)
    np.testing.assert_allclose(evaluator.many(OBS, 4), EXPECTED, rtol=1e-6)
    np.testing.assert_allclose([Evaluator(POTENTIALS[name], BOX).one(obs) for obs in OBS], EXPECTED, rtol=1e-6)
    assert type(evaluator.one(OBS[0])) is float


def test_torch_modules_and_functions():
    torch = pytest.importorskip("torch")
    linear = torch.nn.Linear(4, 1)
    with torch.no_grad():
        expected = linear(torch.as_tensor(OBS))[:, 0].numpy()
    for potential in (linear, lambda obs: linear(obs)[..., 0], torch.nn.Sequential(linear, torch.nn.Flatten(0))):
        evaluator = Evaluator(potential, BOX)
        np.testing.assert_allclose(evaluator.many(OBS, 4), expected, rtol=1e-6)
        assert evaluator.one(OBS[1]) == pytest.approx(expected[1], rel=1e-6)
    assert linear.weight.grad is None


def test_a_prior_and_its_path_are_the_same_potential(prior, tmp_path):
    prior.save(tmp_path / "prior.safetensors")
    values = np.asarray(prior.values(jnp.asarray(OBS)))
    for potential in (prior, str(tmp_path / "prior.safetensors"), tmp_path / "prior.safetensors", prior.to_numpy()):
        np.testing.assert_allclose(Evaluator(potential, BOX).many(OBS, 4), values, rtol=1e-5, atol=1e-6)


def test_discrete_observations():
    table = np.array([0.0, 1.0, 4.0])
    evaluator = Evaluator(lambda state: table[state], Discrete(3))
    assert evaluator.one(np.int64(2)) == 4.0
    np.testing.assert_array_equal(evaluator.many(np.array([2, 0]), 2), [4.0, 0.0])


@pytest.mark.parametrize("batched", [False, True])
def test_dict_observations(batched):
    space = Dict({"a": BOX, "b": Discrete(3)})
    singles = [{"a": obs, "b": np.int64(i % 3)} for i, obs in enumerate(OBS)]
    batch = {"a": OBS, "b": np.arange(4) % 3}

    def potential(obs):
        return obs["a"][:, 1] + obs["b"] if batched else obs["a"][1] + obs["b"]

    expected = OBS[:, 1] + np.arange(4) % 3
    np.testing.assert_allclose(Evaluator(potential, space).many(batch, 4), expected, rtol=1e-6)
    np.testing.assert_allclose(Evaluator(potential, space).several(singles), expected, rtol=1e-6)


class TestPartOfABatch:
    def test_zero_where_nothing_is_needed_and_no_failure_there(self):
        needed = np.array([False, True, False, True])
        mneeded = np.where(needed[:, None], OBS, np.float32(np.nan))
        for potential in (POTENTIALS["numpy, one"], POTENTIALS["numpy, a batch"], POTENTIALS["jax, a batch"]):
            values = Evaluator(potential, BOX).where(mneeded, needed)
            np.testing.assert_allclose(values, np.where(needed, EXPECTED, 0.0), rtol=1e-6)

    def test_batches_keep_their_size_to_avoid_recompilation(self):
        sizes = []

        def potential(obs):
            sizes.append(obs.shape[0])
            return -np.abs(obs[:, 2])

        evaluator = Evaluator(potential, BOX)
        evaluator.many(OBS, 4)
        sizes.clear()
        for count in range(5):
            evaluator.where(OBS, np.arange(4) < count)
        assert sizes == [4, 4, 4, 4], "and Φ is not called where nothing is needed"

    def test_parts(self):
        space = Dict({"a": BOX, "b": Discrete(3)})
        batch = {"a": OBS, "b": np.arange(4) % 3}
        needed = np.array([False, False, True, True])
        values = Evaluator(lambda obs: obs["a"][:, 1] + obs["b"], space).where(batch, needed)
        np.testing.assert_allclose(values, np.where(needed, OBS[:, 1] + np.arange(4) % 3, 0.0), rtol=1e-6)


class TestShapes:
    @pytest.mark.parametrize(
        ("space", "obs", "words"),
        [
            (BOX, OBS[0, :3], r"an observation of shape \(3,\), but its observation space says \(4,\)"),
            (Discrete(3), np.array([1]), r"of shape \(1,\), but its observation space says \(\)"),
            (Dict({"a": Dict({"b": BOX})}), {"a": {"b": OBS[0, :1]}}, r"observation\['a'\]\['b'\] of shape \(1,\)"),
            (Tuple((BOX, Discrete(2))), (OBS[0], np.zeros(2)), r"observation\[1\] of shape \(2,\)"),
            (Tuple((BOX, Discrete(2))), (OBS[0],), "without the part 1"),
        ],
    )
    def test_shapes_that_differ_from_the_space(self, space, obs, words):
        with pytest.raises(UpslopeError, match=words):
            Evaluator(lambda obs: 1.0, space).one(obs)

    def test_batches_that_differ_from_the_space(self):
        space = Dict({"a": BOX})
        with pytest.raises(UpslopeError, match=r"observation\['a'\] of shape \(4, 3\), .* says \(4, 4\)"):
            Evaluator(lambda obs: 1.0, space).many({"a": OBS[:, :3]}, 4)

    def test_observations_without_a_shape_are_unchanged(self):
        assert Evaluator(lambda text: float(len(text)), Text(5)).one("abc") == 3.0


class TestBadPotentials:
    @pytest.mark.parametrize(
        ("potential", "words"),
        [
            (lambda obs: obs, r"returned an array of shape \(4,\) for 1 observation"),
            (lambda obs: "high", "returned str"),
            (lambda obs: None, "returned NoneType"),
            (lambda obs: object(), "returned object"),
            (lambda obs: float("nan"), "potential is nan at the observation"),
            (lambda obs: obs[0] / 0.0 if False else np.inf, "potential is inf"),
            (lambda obs: 1 / 0, "failed on an observation of shape .*ZeroDivisionError"),
            (lambda obs: True, "returned bool"),
        ],
    )
    def test_one_clear_error(self, potential, words):
        with pytest.raises(UpslopeError, match=words):
            Evaluator(potential, BOX).one(OBS[0])
        with pytest.raises(UpslopeError, match=words):
            Evaluator(potential, BOX).many(OBS, 4)

    def test_a_batch_potential_that_returns_too_many(self):
        evaluator = Evaluator(lambda obs: obs[:, 0] if len(obs) == 1 else obs.ravel(), BOX)
        with pytest.raises(UpslopeError, match=r"shape \(16,\) for 4 observations"):
            evaluator.many(OBS, 4)

    @pytest.mark.parametrize("potential", [3.0, None, object(), [1, 2]])
    def test_potentials_that_are_not_callable(self, potential):
        with pytest.raises(UpslopeError, match="is not a potential"):
            Evaluator(potential, BOX)

    def test_a_missing_file(self, tmp_path):
        with pytest.raises(UpslopeError, match="There is no prior at"):
            Evaluator(tmp_path / "gone.safetensors", BOX)

    @pytest.mark.parametrize("space", [Box(-1, 1, (5,)), Box(-1, 1, (4, 1)), Discrete(4), Dict({"a": BOX})])
    def test_a_prior_for_other_observations(self, prior, space):
        with pytest.raises(UpslopeError, match=r"observations of shape \(4,\), but the environment's"):
            Evaluator(prior, space)

    def test_a_prior_accepts_flattened_observations(self, prior):
        env = gym.wrappers.FlattenObservation(gym.make("CartPole-v1"))
        assert Evaluator(prior, env.observation_space).one(OBS[0]) == pytest.approx(
            float(prior(jnp.asarray(OBS[0]))), rel=1e-5
        )
