"""The replay: a ring that holds the newest records, sampled uniformly."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from upslope.errors import UpslopeError
from upslope.learners.replay import Replay

CAPACITY = 4
chunks_of_records = st.lists(st.integers(1, CAPACITY), max_size=6)


def record(number):
    """A record with two leaves of different shapes and types, both containing its number."""
    return {"id": jnp.asarray(number, jnp.int32), "pair": jnp.asarray([number, -number], jnp.float32)}


def records(numbers):
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *map(record, numbers))


def filled(sizes):
    """A replay after chunks of these sizes, and the numbers that were added."""
    replay, numbers = Replay.empty(record(0), CAPACITY), []
    for size in sizes:
        new = list(range(len(numbers) + 1, len(numbers) + 1 + size))
        replay, numbers = replay.add(records(new)), numbers + new
    return replay, numbers


def drawn(replay, count=400, seed=0):
    return jax.jit(Replay.sample, static_argnums=2)(replay, jax.random.key(seed), count)


@given(chunks_of_records)
def test_it_holds_the_newest_records_like_a_plain_list(sizes):
    replay, numbers = filled(sizes)
    newest = numbers[-CAPACITY:]
    present = min(int(replay.added), CAPACITY)
    assert int(replay.added) == len(numbers)
    assert sorted(np.asarray(replay.data["id"])[:present].tolist()) == newest


@given(chunks_of_records.filter(bool))
def test_samples_are_present_records_and_every_one_is_drawn(sizes):
    replay, numbers = filled(sizes)
    assert set(np.asarray(drawn(replay)["id"]).tolist()) == set(numbers[-CAPACITY:])


def test_the_oldest_records_are_replaced_in_order():
    replay, _ = filled([3, 2])
    # 1, 2, 3, 4 fill the ring; 5 replaces 1.
    assert replay.data["id"].tolist() == [5, 2, 3, 4]


def test_the_leaves_of_a_record_stay_together():
    sample = drawn(filled([4, 3])[0])
    np.testing.assert_array_equal(sample["pair"][:, 0], sample["id"])
    np.testing.assert_array_equal(sample["pair"][:, 1], -sample["id"])


def test_types_and_shapes_are_those_of_the_example():
    replay = Replay.empty(record(0), CAPACITY)
    assert (replay.data["id"].dtype, replay.data["id"].shape) == (jnp.int32, (CAPACITY,))
    assert (replay.data["pair"].dtype, replay.data["pair"].shape) == (jnp.float32, (CAPACITY, 2))
    assert replay.capacity == CAPACITY


@pytest.mark.parametrize("present", [3, 4])
def test_sampling_is_uniform(present):
    count = 12_000
    ids = np.asarray(drawn(filled([present])[0], count)["id"])
    observed = np.bincount(ids, minlength=present + 1)[1:]
    expected = count / present
    # χ² with 2 or 3 degrees of freedom exceeds 20 less than once in 5,000 draws; the key is fixed.
    assert np.sum((observed - expected) ** 2 / expected) < 20


def test_different_keys_draw_different_records():
    replay, _ = filled([4])
    assert drawn(replay, seed=0)["id"].tolist() != drawn(replay, seed=1)["id"].tolist()


def test_adding_does_not_change_the_original_replay():
    replay, _ = filled([2])
    before = replay.data["id"].tolist()
    replay.add(records([9]))
    assert replay.data["id"].tolist() == before
    assert int(replay.added) == 2


def test_a_replay_of_given_records_contains_exactly_these():
    replay = Replay.of(records([7, 8, 9]))
    assert (replay.capacity, int(replay.added)) == (3, 3)
    assert set(np.asarray(drawn(replay)["id"]).tolist()) == {7, 8, 9}


def test_more_records_than_fit_are_refused():
    with pytest.raises(UpslopeError, match="5 records at once do not fit into a replay of 4"):
        Replay.empty(jnp.zeros(()), 4).add(jnp.arange(5.0))
