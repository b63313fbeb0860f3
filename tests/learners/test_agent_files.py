"""Files of agents: damaged files raise a typed error, and existing files are not overwritten."""

import json

import jax
import numpy as np
import pytest

from upslope import Agent, DDPGConfig, DQNConfig, UpslopeError, cartpoles, grid_games, storage
from upslope.errors import DamagedFileError
from upslope.learners.agent import FORMAT, FORMAT_VERSION, record
from upslope.networks.tensors import to_tensors

CASES = {
    "dqn": (DQNConfig(hidden=(6, 5)), cartpoles()),
    "ddpg": (DDPGConfig(hidden=(6, 5)), cartpoles(continuous=True)),
    "dqn on maps": (DQNConfig(hidden=(6,), precision="bfloat16"), grid_games((4, 5))),
}


def fresh(config, family) -> Agent:
    network = config.policy_network(
        jax.random.key(3), family.observation_shape, family.actions.count, family.observation_scale
    )
    return Agent(network, record(config, family, seed=4))


@pytest.fixture
def agent():
    return fresh(*CASES["dqn"])


def write(path, agent, header=None, tensors=None, version=FORMAT_VERSION, kind=FORMAT):
    """Writes a file with valid checksums and arbitrary content."""
    agent.save(path)
    stored = storage.read(path, FORMAT, FORMAT_VERSION)
    about = stored.header["trained_on"] | (header or {})
    storage.write(path, kind, version, {"trained_on": about}, stored.arrays | (tensors or {}))


@pytest.mark.parametrize("case", CASES)
def test_a_round_trip(case, tmp_path):
    agent = fresh(*CASES[case])
    agent.save(tmp_path / "agent.safetensors")
    loaded = Agent.load(tmp_path / "agent.safetensors")
    assert loaded.trained_on == agent.trained_on
    assert type(loaded.network) is type(agent.network)
    obs = np.random.default_rng(0).normal(size=(30, *agent.trained_on.observation_shape)).astype(np.float32)
    np.testing.assert_array_equal(loaded.act(obs), agent.act(obs))
    for name, tensor in to_tensors(agent.network).items():
        np.testing.assert_array_equal(to_tensors(loaded.network)[name], tensor)


def test_every_flipped_byte_of_the_header_and_some_others(agent, tmp_path):
    path = tmp_path / "agent.safetensors"
    agent.save(path)
    whole = path.read_bytes()
    places = {*range(0, len(whole), 37), len(whole) - 1}
    for place in places:
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0xFF]) + whole[place + 1 :])
        with pytest.raises(DamagedFileError):
            Agent.load(path)
    for length in (0, 7, 100, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(DamagedFileError):
            Agent.load(path)


@pytest.mark.parametrize(
    "header",
    [
        {"learner": "sarsa"},
        {"learner": ["dqn"]},
        {"settings": {"hidden": [6, 5], "surprise": 1}},
        {"settings": {"hidden": [6, 4]}},
        {"settings": {"hidden": ["wide"]}},
        {"settings": {"precision": "float1"}},
        {"settings": 3},
        {"observation_shape": []},
        {"observation_shape": [-4]},
        {"observation_shape": [4.0]},
        {"observation_shape": 4},
        {"observation_scale": [1.0]},
        {"observation_scale": [1.0, 1.0, 1.0, float("inf")]},
        {"observation_scale": ["1", "1", "1", "1"]},
        {"actions": 3},
        {"actions": 0},
        {"surprise": 1},
    ],
    ids=json.dumps,
)
def test_invalid_headers(header, agent, tmp_path):
    write(tmp_path / "agent.safetensors", agent, header)
    with pytest.raises(DamagedFileError, match="train the agent again"):
        Agent.load(tmp_path / "agent.safetensors")


@pytest.mark.parametrize(
    ("tensors", "words"),
    [
        ({"head.bias": np.full(2, np.nan, np.float32)}, "not finite"),
        ({"head.bias": np.zeros(3, np.float32)}, "head.bias"),
        ({"head.bias": np.zeros(2)}, "float64"),
        ({"another": np.zeros(2, np.float32)}, "other tensors"),
    ],
)
def test_tensors_that_do_not_fit(tensors, words, agent, tmp_path):
    write(tmp_path / "agent.safetensors", agent, tensors=tensors)
    with pytest.raises(DamagedFileError, match=words):
        Agent.load(tmp_path / "agent.safetensors")


def test_other_files(agent, tmp_path, prior):
    prior.save(tmp_path / "prior.safetensors")
    with pytest.raises(DamagedFileError, match="upslope-prior"):
        Agent.load(tmp_path / "prior.safetensors")
    write(tmp_path / "newer.safetensors", agent, version=FORMAT_VERSION + 1)
    with pytest.raises(DamagedFileError, match="install the version"):
        Agent.load(tmp_path / "newer.safetensors")
    with pytest.raises(UpslopeError, match="There is no agent at") as caught:
        Agent.load(tmp_path / "gone.safetensors")
    assert not isinstance(caught.value, DamagedFileError)


def test_files_are_overwritten_only_on_request(agent, tmp_path):
    path = tmp_path / "agent.safetensors"
    agent.save(path)
    before = path.read_bytes()
    with pytest.raises(UpslopeError, match="exists already"):
        fresh(*CASES["ddpg"]).save(path)
    assert path.read_bytes() == before
    fresh(*CASES["ddpg"]).save(path, overwrite=True)
    assert Agent.load(path).trained_on.learner == "ddpg"
    (tmp_path / "file").write_text("")
    with pytest.raises(UpslopeError, match="can't be written"):
        agent.save(tmp_path / "file" / "agent.safetensors")
