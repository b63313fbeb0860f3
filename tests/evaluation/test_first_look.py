"""Families that can't be learned are named before the training: one sentence for each kind."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import pytest

from support.corridor import Corridor, RandomGoals, corridors
from upslope.errors import PriorWarning, UpslopeError
from upslope.evaluation.first_look import look_at
from upslope.tasks import JaxTasks, cartpoles

KEY = jax.random.key(0)


@dataclass(frozen=True)
class Broken(Corridor):
    """A corridor with a fault in its observations or rewards."""

    fault: str = ""

    def observe(self, place, goal):
        obs = super().observe(place, goal)
        return {"not a number": obs.at[3].set(jnp.nan), "constant": jnp.ones_like(obs)}.get(self.fault, obs)

    def step(self, key, state, action, params):
        obs, state, reward, *rest = super().step(key, state, action, params)
        return obs, state, jnp.inf if self.fault == "infinite reward" else reward, *rest


@pytest.mark.parametrize("family", [corridors(), cartpoles()], ids=["corridors", "poles"])
def test_a_sound_family_passes(family, recwarn):
    look_at(family, KEY)
    assert not [warning for warning in recwarn if warning.category is PriorWarning]


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("not a number", "gave the observation nan in its first random steps"),
        ("constant", "Observations of 'corridor' never change"),
        ("infinite reward", "gave the reward inf"),
    ],
)
def test_what_can_not_be_learned_from_is_named(fault, words):
    family = replace(corridors(), env=Broken(fault=fault))
    with pytest.raises(UpslopeError, match=words):
        look_at(family, KEY)


def test_equal_tasks_are_named():
    family = corridors()
    assert isinstance(family, JaxTasks)
    with pytest.warns(PriorWarning, match="All 10 tasks that were drawn of 'corridor' are the same"):
        look_at(family.only(RandomGoals()(KEY)), KEY)
