"""Programs compiled ahead: the same results, nothing compiled twice, and no call waits in vain."""

import threading
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.comparing import assert_trees_identical
from support.toys import Walk, walks
from upslope.run.compiling import Ahead, compile_clock, shapes_of
from upslope.run.engines import ENGINES, lay_out
from upslope.run.loop import expect, run
from upslope.run.session import Session

COUNT = 5  # learners, unlike in other tests, so that nothing of theirs is compiled already


def keys(count=COUNT):
    return jax.random.split(jax.random.key(0), count)


def wait_for(ahead, learners, count=COUNT):
    ahead.wait(shapes_of(lay_out(ENGINES[learners.engine], learners, keys(count))))


class TestExpect:
    def test_what_was_compiled_ahead_is_not_compiled_again(self):
        with Ahead() as ahead:
            expect(walks([0.0] * COUNT), keys(), ahead)
            wait_for(ahead, walks([0.0] * COUNT))
            # Other numbers of the same shapes, and another length: the same programs.
            outcome = run(walks([1.0] * COUNT), keys(), updates=4, every=2, session=Session(ahead=ahead))
        assert outcome.programs == 0

    def test_it_changes_no_bit(self):
        alone = run(walks([1.0] * COUNT), keys(), updates=4, every=2)
        with Ahead() as ahead:
            expect(walks([0.0] * COUNT), keys(), ahead)
            ahead_of_time = run(walks([1.0] * COUNT), keys(), updates=4, every=2, session=Session(ahead=ahead))
        assert_trees_identical(alone.states, ahead_of_time.states)
        assert_trees_identical(alone.reports, ahead_of_time.reports)

    def test_who_was_not_expected_compiles_in_time(self):
        with Ahead() as ahead:
            outcome = run(walks([0.5] * 6), keys(6), updates=3, every=3, session=Session(ahead=ahead))
        np.testing.assert_array_equal(outcome.updates, [0, 3])

    def test_a_program_that_fails_tells_its_caller_why(self):
        class Broken(Walk):
            def init(self, key):
                raise ValueError("no start here")

        broken = Broken(jnp.zeros(COUNT), jnp.zeros(COUNT, jnp.int32))
        with Ahead() as ahead:
            expect(broken, keys(), ahead)
            with pytest.raises(ValueError, match="no start here"):
                run(broken, keys(), updates=1, every=1, session=Session(ahead=ahead))


class TestTheBackground:
    def test_each_name_is_compiled_once(self):
        done = []
        with Ahead() as ahead:
            for _ in range(3):
                ahead.submit("one", lambda: done.append("one"))
            ahead.wait("one")
        assert done == ["one"]

    def test_waiting_for_an_unknown_program_returns_at_once(self):
        with Ahead() as ahead:
            ahead.wait("unknown")

    def test_at_the_end_what_was_not_begun_is_dropped_and_what_was_begun_has_ended(self):
        done, begun = [], threading.Event()

        def slow():
            begun.set()
            time.sleep(0.2)
            done.append("first")

        with Ahead() as ahead:
            ahead.submit("first", slow)
            ahead.submit("second", lambda: done.append("second"))
            begun.wait()
        assert done == ["first"]

    def test_the_clock_counts_the_wait_not_the_work(self):
        finished = threading.Event()

        def slow():
            time.sleep(0.5)
            finished.set()

        with compile_clock() as clock, Ahead() as ahead:
            ahead.submit("slow", slow)
            finished.wait()
            ahead.wait("slow")
            assert 0 < clock.seconds < 0.4  # the wait was over at once
            ahead.submit("again", lambda: time.sleep(0.2))
            ahead.wait("again")
        assert clock.seconds > 0.1

    def test_the_clock_counts_the_programs_of_all_threads(self):
        with compile_clock() as clock, Ahead() as ahead:
            program = jax.jit(lambda x: x * 3 + COUNT)
            ahead.submit("one", lambda: program.lower(np.ones(COUNT)).compile())
            ahead.wait("one")
        assert clock.programs == 1
