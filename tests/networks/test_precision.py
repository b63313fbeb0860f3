"""How many bits the convolutions of a network multiply with."""

import dataclasses

import jax
import numpy as np
import pytest

import upslope
from support.comparing import assert_trees_identical
from upslope.errors import UpslopeError
from upslope.learners.dqn import DQN, for_maps
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.config import MetaTrainingConfig
from upslope.networks.dueling import DuelingQ
from upslope.networks.precision import with_precision
from upslope.networks.q_network import QNetwork


def test_fewer_bits_move_the_values_of_a_convolutional_network_a_little():
    obs = jax.random.uniform(jax.random.key(1), (4, 5, 4))
    exact = DuelingQ(jax.random.key(0), (4, 5, 4), 3)
    rough = with_precision(exact, "bfloat16")
    assert rough.torso.precision == "bfloat16"
    assert 0 < np.abs(rough(obs) - exact(obs)).max() < 0.05
    np.testing.assert_array_equal(with_precision(rough, "float32")(obs), exact(obs))


def test_a_network_without_convolutions_does_not_change():
    network = QNetwork(jax.random.key(0), 4, 2)
    assert_trees_identical(with_precision(network, "bfloat16"), network)


def test_learners_set_it():
    maps = upslope.obstacle_maps()
    theta = jax.eval_shape(MetaTraining(maps, MetaTrainingConfig(precision="bfloat16")).init, jax.random.key(0)).theta
    task = maps.sample(jax.random.key(1))
    settings = dataclasses.replace(for_maps(), precision="tensorfloat32")
    learner = jax.eval_shape(DQN(maps, task, None, settings).init, jax.random.key(0))
    assert (theta.torso.precision, learner.network.torso.precision) == ("bfloat16", "tensorfloat32")


def test_an_unknown_one():
    with pytest.raises(UpslopeError, match="no precision 'half': choose float32"):
        with_precision(QNetwork(jax.random.key(0), 4, 2), "half")
