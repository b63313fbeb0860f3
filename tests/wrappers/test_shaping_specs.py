"""Specs of shaped environments: they round-trip through Gymnasium for every kind of potential."""

import pickle
from pathlib import Path

import gymnasium as gym
import pytest

from support.scripted import level
from upslope import PotentialShaping


def make(potential, **settings):
    return PotentialShaping(gym.make("CartPole-v1"), potential, 0.98, **settings)


@pytest.mark.parametrize("exported", [False, True])
def test_a_prior_round_trips_through_make(prior, exported):
    first = make(prior.to_numpy() if exported else prior, scale=0.5, bias=3.0)
    second = gym.make(pickle.loads(pickle.dumps(first.spec)))
    assert isinstance(second, PotentialShaping)
    assert second.spec == first.spec
    rewards = []
    for env in (first, second):
        env.reset(seed=4)
        rewards.append([env.step(t % 2)[1] for t in range(8)])
    assert rewards[0] == rewards[1]
    assert len(set(rewards[0])) == 8


def test_a_spec_keeps_every_setting():
    settings = {"scale": 0.5, "bias": 3.0, "enabled": False, "anneal_steps": 7, "repeat": 2}
    kept = make(level, **settings).spec.additional_wrappers[-1].kwargs
    assert kept == settings | {"potential": level, "gamma": 0.98}


@pytest.mark.parametrize("kind", [str, Path])
def test_a_path_makes_a_spec_of_plain_json(prior, tmp_path, kind):
    prior.save(tmp_path / "prior.safetensors")
    first = make(kind(tmp_path / "prior.safetensors"), anneal_steps=100)
    spec = gym.envs.registration.EnvSpec.from_json(first.spec.to_json())
    second = gym.make(spec)
    for env in (first, second):
        env.reset(seed=4)
    assert first.step(1)[1] == second.step(1)[1] != 1.0
