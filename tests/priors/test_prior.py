"""Priors on disk: bit-identical, with their provenance; files that can't be trusted are refused by name."""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from safetensors.numpy import save_file

from support.comparing import assert_trees_identical
from upslope import storage
from upslope.errors import UpslopeError
from upslope.networks.dueling import DuelingQ
from upslope.priors.prior import Prior, TrainedOn, trained_on
from upslope.priors.prior_file import FORMAT, FORMAT_VERSION
from upslope.tasks import cartpoles, grid_games
from upslope.tasks.actions import DiscreteActions

FAMILY = cartpoles(gamma=0.97)
SETTINGS = {"iterations": 7, "epsilon": [0.05, 0.95], "target_decay": None}
NETWORK = DuelingQ(jax.random.key(0), 4, 2, (6, 5), FAMILY.observation_scale, "tanh")
PRIOR = Prior(NETWORK, trained_on(FAMILY, NETWORK, 3, SETTINGS))
OBS = jnp.array([[0.1, -0.2, 0.05, 1.0], [-1.0, 0.5, 0.1, 0.0]])

GOLDEN_VALUES = [-0.5532793998718262, -0.5099821090698242]


@pytest.fixture
def path(tmp_path):
    return tmp_path / "folder" / "prior.safetensors"


@pytest.fixture
def saved(path):
    PRIOR.save(path)
    return path


def test_a_convolutional_prior_comes_back_bit_for_bit(path):
    family = grid_games((3, 4))
    network = DuelingQ(jax.random.key(0), family.observation_shape, 4, (6, 5), family.observation_scale)
    Prior(network, trained_on(family, network, 3, SETTINGS)).save(path)
    loaded = Prior.load(path)
    assert_trees_identical(loaded.network, network)
    assert loaded.trained_on.hidden == (6, 5)
    loaded.check(family, acting=True)
    with pytest.raises(UpslopeError, match="observation shape"):
        loaded.check(grid_games((4, 3)))


def rewritten(path, *, tensors=None, header=None, version=FORMAT_VERSION):
    """The file, honestly signed, with some tensors or header entries replaced; None takes one out."""
    there = storage.read(path, FORMAT, FORMAT_VERSION)
    kept, entries = there.arrays | (tensors or {}), there.header | (header or {})
    storage.write(
        path,
        FORMAT,
        version,
        {name: value for name, value in entries.items() if value is not None},
        {name: value for name, value in kept.items() if value is not None},
    )
    return path


def provenance(**changes):
    """The header with some entries of the provenance replaced."""
    return {"trained_on": dataclasses.asdict(PRIOR.trained_on) | changes}


def refused(path, match=None):
    """Loading must fail with a message that names the file."""
    with pytest.raises(UpslopeError, match=match) as caught:
        Prior.load(path)
    assert str(path) in str(caught.value)


class TestUse:
    def test_it_is_the_value_head(self):
        assert float(PRIOR(OBS[0])) == float(NETWORK.value(OBS[0]))

    def test_batches(self):
        np.testing.assert_allclose(PRIOR.values(OBS), [float(PRIOR(obs)) for obs in OBS], rtol=1e-5)

    def test_gamma_is_the_family_s(self):
        assert PRIOR.gamma == 0.97

    def test_provenance_tells_the_network(self):
        expected = TrainedOn(
            family="cartpole", gamma=0.97, observation_shape=(4,), observation_scale=FAMILY.observation_scale,
            actions=2, hidden=(6, 5), activation="tanh", seed=3, settings=SETTINGS, version=PRIOR.trained_on.version,
        )  # fmt: skip
        assert PRIOR.trained_on == expected
        assert PRIOR.trained_on.version


class TestRoundTrip:
    def test_parameters_come_back_bit_for_bit(self, saved):
        assert_trees_identical(Prior.load(saved).network, NETWORK)

    def test_provenance_comes_back(self, saved):
        assert Prior.load(saved).trained_on == PRIOR.trained_on

    def test_it_acts_and_shapes_as_before(self, saved):
        loaded = Prior.load(str(saved))
        np.testing.assert_array_equal(loaded.values(OBS), PRIOR.values(OBS))
        np.testing.assert_array_equal(jax.vmap(loaded.network)(OBS), jax.vmap(NETWORK)(OBS))

    def test_it_can_be_saved_and_loaded_again(self, saved, tmp_path):
        Prior.load(saved).save(tmp_path / "again.safetensors")
        again = Prior.load(tmp_path / "again.safetensors")
        assert_trees_identical(again.network, NETWORK)
        assert again.trained_on == PRIOR.trained_on


class TestSaving:
    def test_nothing_is_overwritten(self, saved):
        before = saved.read_bytes()
        with pytest.raises(UpslopeError, match="nothing is overwritten") as caught:
            PRIOR.save(saved)
        assert str(saved) in str(caught.value)
        assert saved.read_bytes() == before

    def test_below_a_file_nothing_can_be_saved(self, saved):
        with pytest.raises(UpslopeError, match="can't be written"):
            PRIOR.save(saved / "below.safetensors")


class TestDamage:
    def test_missing(self, path):
        refused(path, "There is no prior")

    def test_a_folder(self, tmp_path):
        refused(tmp_path, "There is no prior")

    @pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.99])
    def test_truncated(self, saved, share):
        whole = saved.read_bytes()
        saved.write_bytes(whole[: int(share * len(whole))])
        refused(saved, "damaged")

    def test_no_safetensors_at_all(self, path):
        path.parent.mkdir()
        path.write_text("import torch  # some other file altogether, long enough to hold a header's length\n" * 3)
        refused(path, "damaged")

    @pytest.mark.parametrize(
        ("metadata", "words"),
        [(None, "not a file of upslope"), ({"format": "pt"}, "not an upslope-prior file: its format is 'pt'")],
    )
    def test_foreign(self, path, metadata, words):
        path.parent.mkdir()
        save_file({"weight": np.zeros(3, np.float32)}, path, metadata=metadata)
        refused(path, words)

    @pytest.mark.parametrize("version", [0, 3])
    def test_other_format_versions(self, saved, version):
        refused(rewritten(saved, version=version), "reads format 2")

    @pytest.mark.parametrize(
        "header",
        [
            pytest.param({"trained_on": None}, id="none"),
            pytest.param({"trained_on": "text"}, id="text"),
            pytest.param({"trained_on": []}, id="no mapping"),
            pytest.param({"trained_on": {"family": "cartpole"}}, id="entries missing"),
            pytest.param(provenance(surprise=1), id="an unknown entry"),
            pytest.param(provenance(activation="sine"), id="an unknown activation"),
            pytest.param(provenance(hidden=[]), id="no hidden layers"),
            pytest.param(provenance(hidden=[-6, 5]), id="a negative width"),
            pytest.param(provenance(hidden="65"), id="widths as text"),
            pytest.param(provenance(observation_shape=[]), id="no observation shape"),
            pytest.param(provenance(observation_scale=[1.0]), id="scales for another shape"),
            pytest.param(provenance(actions="two"), id="actions as text"),
            pytest.param(provenance(gamma="high"), id="gamma as text"),
            pytest.param(provenance(gamma=1.5), id="gamma beyond one"),
        ],
    )
    def test_headers(self, saved, header):
        refused(rewritten(saved, header=header))


class TestTensors:
    @pytest.mark.parametrize(
        "tensor",
        [
            pytest.param(np.zeros((5, 1), np.float32), id="transposed"),
            pytest.param(np.zeros((1, 5), np.float64), id="another type"),
            pytest.param(np.zeros((1, 4), np.float32), id="too small"),
        ],
    )
    def test_of_another_shape_or_type(self, saved, tensor):
        refused(rewritten(saved, tensors={"value_head.weight": tensor}), "value_head.weight is float")

    @pytest.mark.parametrize("value", [np.nan, np.inf])
    def test_not_finite(self, saved, value):
        bias = np.array([value], np.float32)
        refused(
            rewritten(saved, tensors={"value_head.bias": bias}), "value_head.bias holds numbers that are not finite"
        )

    @pytest.mark.parametrize("tensors", [{"value_head.bias": None}, {"value_head.extra": np.zeros(1, np.float32)}])
    def test_missing_or_unknown(self, saved, tensors):
        refused(rewritten(saved, tensors=tensors), "other tensors")

    def test_of_another_width_than_announced(self, saved):
        refused(rewritten(saved, header=provenance(hidden=[6, 4])), "the header announces")


class TestCheck:
    def test_its_own_family_fits(self):
        PRIOR.check(FAMILY, acting=True)

    def test_the_continuous_twin_fits_for_shaping_but_not_for_acting(self):
        twin = cartpoles(gamma=0.97, continuous=True)
        PRIOR.check(twin)
        with pytest.raises(UpslopeError, match="number of actions"):
            PRIOR.check(twin, acting=True)

    def test_other_lengths_of_the_same_family_fit(self):
        PRIOR.check(cartpoles((0.5, 1.0), gamma=0.97), acting=True)

    @pytest.mark.parametrize(
        ("change", "match"),
        [
            ({"name": "grid"}, "the family is cartpole in the prior and grid in the tasks"),
            ({"gamma": 0.98}, r"gamma is 0\.97 in the prior and 0\.98 in the tasks"),
            ({"observation_shape": (6,)}, "observation shape"),
        ],
    )
    def test_mismatches(self, change, match):
        with pytest.raises(UpslopeError, match=match):
            PRIOR.check(dataclasses.replace(FAMILY, **change))

    def test_other_actions_matter_for_acting_only(self):
        other = dataclasses.replace(FAMILY, actions=DiscreteActions(3))
        PRIOR.check(other)
        with pytest.raises(UpslopeError, match="number of actions is 2 in the prior and 3"):
            PRIOR.check(other, acting=True)


def test_golden_prior_of_format_1():
    """Written by the first version that signed its files; it must load for ever."""
    golden = Prior.load(Path(__file__).parents[1] / "golden" / "prior-format-1.safetensors")
    assert golden.trained_on == dataclasses.replace(PRIOR.trained_on, version=golden.trained_on.version)
    np.testing.assert_allclose(golden.values(OBS), GOLDEN_VALUES, rtol=1e-6)
