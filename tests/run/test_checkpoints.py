"""Runs that stop and go on: bit for bit as if they had never stopped."""

import json
import signal
import threading
import time
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.comparing import assert_trees_identical
from support.toys import Memory, walks
from upslope import storage
from upslope.adaptation.algorithm2 import Adaptation
from upslope.adaptation.fine_tuning import FineTuning
from upslope.errors import DamagedFileError, InterruptedRunError, NotSavedError, UpslopeError
from upslope.learners.ddpg import DDPG, DDPGConfig
from upslope.learners.dqn import DQN, DQNConfig
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.posteriors import NetworkPosterior
from upslope.networks.dueling import DuelingQ
from upslope.run.checkpoints import Checkpoints, adopt
from upslope.run.engines import CompiledEngine
from upslope.run.loop import broadcast, run
from upslope.run.observers import EventLog
from upslope.run.session import Session
from upslope.run.signals import stop_requests
from upslope.tasks import cartpoles

POLES = cartpoles((0.5, 2.0))
FORCES = cartpoles((0.5, 2.0), continuous=True)
KEYS = jax.random.split(jax.random.key(5), 3)


def network():
    return DuelingQ(jax.random.key(1), 4, 2, (8,))


LEARNERS = {
    "Algorithm 1": MetaTraining(
        POLES,
        MetaTrainingConfig(
            iterations=7, tasks=2, steps_per_task=8, posterior=NetworkPosterior(batch_size=4), evaluation_tasks=1
        ),
    ),
    "Algorithm 2": Adaptation(POLES, POLES.sample(jax.random.key(0)), network(), jnp.asarray(1e-3)),
    "MAML": Adaptation(POLES, POLES.sample(jax.random.key(0)), network(), jnp.asarray(1e-3), FineTuning()),
    "DQN": DQN(POLES, POLES.sample(jax.random.key(0)), None, DQNConfig(replay_capacity=300, hidden=(8,))),
    "DDPG": DDPG(FORCES, FORCES.sample(jax.random.key(0)), None, DDPGConfig(replay_capacity=300, hidden=(8,))),
}


class Saboteur:
    """An observer that does something at one update."""

    def __init__(self, at, deed):
        self.at, self.deed = at, deed

    def begin(self, title, updates, learners): ...

    def record(self, update, returns, metrics, *, at):
        if update == self.at:
            self.deed()

    def end(self): ...


def send(number):
    return lambda: signal.raise_signal(number)


def checkpoints(folder, **settings):
    return Checkpoints(folder, **{"every_updates": 1, **settings})


def walk(folder=None, *, observers=(), updates=7, until=None, drifts=(0.0, 1.0, 2.0), keys=KEYS, **settings):
    kept = None if folder is None else checkpoints(folder, **settings)
    return run(walks(list(drifts)), keys, updates=updates, every=2, until=until, session=Session(observers, kept))


def stop_at(folder, update, number=signal.SIGTERM, **settings):
    with pytest.raises(InterruptedRunError) as caught:
        walk(folder, observers=[Saboteur(update, send(number))], **settings)
    return caught.value


def files(folder):
    return sorted((folder / "checkpoints" / "learning").glob("*"))


def assert_same(one, other):
    assert_trees_identical(jax.tree.map(_plain, one.states), jax.tree.map(_plain, other.states))
    assert_trees_identical((one.reports, one.metrics, one.updates), (other.reports, other.metrics, other.updates))


def _plain(leaf):
    return jax.random.key_data(leaf) if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key) else np.asarray(leaf)


class TestResuming:
    @pytest.mark.parametrize(
        "learner",
        [
            pytest.param(learner, id=name, marks=[pytest.mark.slow] * (name != "DQN"))
            for name, learner in LEARNERS.items()
        ],
    )
    def test_every_learner_goes_on_bit_for_bit(self, tmp_path, learner):
        def go(session=None):
            return run(broadcast(learner, (3,)), KEYS, updates=5, every=2, session=session)

        with pytest.raises(InterruptedRunError):
            go(Session([Saboteur(2, send(signal.SIGTERM))], checkpoints(tmp_path)))
        assert_same(go(Session((), checkpoints(tmp_path, resume=True))), go())

    @pytest.mark.parametrize("update", [0, 2, 4, 6])
    def test_from_any_mark(self, tmp_path, update):
        stop_at(tmp_path, update)
        assert_same(walk(tmp_path, resume=True), walk())

    def test_between_marks(self, tmp_path):
        """Chunks are about a second long, so that saves fall between marks too; sums of metrics must survive that."""
        whole = run(walks([0.0, 1.0, 2.0]), KEYS, updates=2000, every=1000)
        kept = checkpoints(tmp_path, every_updates=100, keep=100)
        run(walks([0.0, 1.0, 2.0]), KEYS, updates=2000, every=1000, session=Session((), kept))
        between = [path for path in files(tmp_path) if int(path.stem) % 1000]
        assert between
        for path in between[:3]:
            resumed = checkpoints(tmp_path, resume=path, every_updates=10_000)
            again = run(walks([0.0, 1.0, 2.0]), KEYS, updates=2000, every=1000, session=Session((), resumed))
            assert_same(again, whole)

    def test_a_finished_run_is_only_read(self, tmp_path):
        first, memory = walk(tmp_path), Memory()
        again = walk(tmp_path, resume=True, observers=[memory])
        assert_same(again, first)
        assert [call[1] for call in memory.calls if call[0] == "record"] == [0, 2, 4, 6, 7]

    def test_final_states_are_only_kept_on_request(self, tmp_path):
        first = walk(tmp_path, final_states=False)
        again = walk(tmp_path, final_states=False, resume=True)
        assert again.flat_states is None
        assert_trees_identical(again.reports, first.reports)
        assert len(files(tmp_path)) == 1

    def test_one_that_ended_early_is_continued(self, tmp_path):
        first = walk(tmp_path, until=4, final_states=False)
        assert first.updates.tolist() == [0, 2, 4]
        assert_same(walk(tmp_path, until=4, resume=True), first)
        assert_same(walk(tmp_path, resume=True), walk())

    def test_of_one_that_went_farther_only_the_beginning_is_taken(self, tmp_path):
        first, memory = walk(tmp_path), Memory()
        begun = walk(tmp_path, until=4, resume=True, observers=[memory])
        assert begun.flat_states is None, "those there are of a later step"
        assert begun.updates.tolist() == [0, 2, 4]
        assert [call[1] for call in memory.calls if call[0] == "record"] == [0, 2, 4]
        of_first = jax.tree.map(lambda leaf: leaf[:, :3], (first.reports, first.metrics))
        assert_trees_identical((begun.reports, begun.metrics), of_first)
        assert_same(walk(tmp_path, resume=True), first)

    def test_nothing_there_means_a_fresh_start(self, tmp_path):
        assert_same(walk(tmp_path, resume=True), walk())

    def test_logs_have_neither_gaps_nor_duplicates(self, tmp_path):
        log = EventLog(tmp_path / "logs")
        with pytest.raises(InterruptedRunError):
            walk(tmp_path, observers=[log, Saboteur(4, send(signal.SIGTERM))])
        walk(tmp_path, observers=[EventLog(tmp_path / "logs")], resume=True)
        lines = (tmp_path / "logs" / "learning" / "metrics.jsonl").read_text().splitlines()
        assert [json.loads(line)["update"] for line in lines] == [0, 2, 4, 6, 7]
        times = [json.loads(line)["at"] for line in lines]
        assert times == sorted(times)
        assert len(list((tmp_path / "logs" / "learning").glob("events*"))) == 1

    def test_time_between_stop_and_resumption_does_not_count_as_running(self, tmp_path, monkeypatch):
        stop_at(tmp_path, 4)
        saved = storage.read(files(tmp_path)[-1], "upslope-checkpoint", 1).arrays
        hours_later = time.time() + 10_000.0
        monkeypatch.setattr(time, "time", lambda: hours_later)
        resumed = walk(tmp_path, resume=True)
        before = len(saved["seconds"])
        np.testing.assert_array_equal(resumed.seconds[:before], saved["seconds"])
        assert (np.diff([*resumed.seconds[:before], saved["elapsed"], *resumed.seconds[before:]]) > 0).all()
        assert resumed.seconds[-1] < 10_000

    def test_on_another_number_of_learners_than_the_devices_divide(self, tmp_path):
        stop_at(tmp_path, 2)
        (file, *_) = files(tmp_path)
        arrays = storage.read(file, "upslope-checkpoint", 1).arrays
        assert arrays["states/place"].shape == (3,)


class TestAdopting:
    """A run that begins with one that another folder holds."""

    def test_what_is_there_is_not_learned_again(self, tmp_path, monkeypatch):
        first = walk(tmp_path / "one", final_states=False)
        adopt(["learning"], tmp_path / "one", tmp_path / "other")
        monkeypatch.setattr(CompiledEngine, "start", lambda *_: pytest.fail("it started again"))
        again = walk(tmp_path / "other", resume=True, final_states=False)
        assert_trees_identical((again.reports, again.metrics), (first.reports, first.metrics))
        assert files(tmp_path / "one"), "nothing was moved away"

    def test_one_that_was_stopped_is_continued(self, tmp_path):
        stop_at(tmp_path / "one", 4)
        adopt(["learning"], tmp_path / "one", tmp_path / "other")
        assert_same(walk(tmp_path / "other", resume=True), walk())

    def test_other_settings_are_refused(self, tmp_path):
        walk(tmp_path / "one")
        adopt(["learning"], tmp_path / "one", tmp_path / "other")
        with pytest.raises(UpslopeError, match="updates was 7, is now 9"):
            walk(tmp_path / "other", resume=True, updates=9)

    def test_nothing_there_is_an_error(self, tmp_path):
        walk(tmp_path / "one")
        with pytest.raises(UpslopeError, match="no training called 'walking': give the folder"):
            adopt(["walking"], tmp_path / "one", tmp_path / "other")

    def test_no_room_is_an_error(self, tmp_path):
        walk(tmp_path / "one")
        (tmp_path / "other").write_text("a file, no folder")
        with pytest.raises(NotSavedError, match="can't be copied"):
            adopt(["learning"], tmp_path / "one", tmp_path / "other")


class TestWhatIsKept:
    def test_the_newest_only(self, tmp_path):
        walk(tmp_path, keep=2)
        assert [int(path.stem) for path in files(tmp_path)] == [6, 7]

    def test_by_the_clock(self, tmp_path, monkeypatch):
        """Every ten seconds of a clock that moves by six with every look; saving itself counts for nothing."""
        now = iter(range(0, 10_000, 6))
        monkeypatch.setattr("upslope.run.checkpoints.time.monotonic", lambda: next(now))
        monkeypatch.setattr("upslope.run.checkpoints._LEAST_PAUSE", 0)
        walk(tmp_path, every_updates=None, every_seconds=10.0, keep=100)
        assert 2 < len(files(tmp_path)) < 7

    def test_seldom_where_saving_takes_long(self, tmp_path, monkeypatch):
        """A save of six seconds is followed by the next after six minutes: the one at the end."""
        now = iter(range(0, 10_000, 6))
        monkeypatch.setattr("upslope.run.checkpoints.time.monotonic", lambda: next(now))
        walk(tmp_path, every_updates=None, every_seconds=10.0, keep=100)
        assert [int(path.stem) for path in files(tmp_path)] == [1, 7]

    def test_a_clock_set_back_does_not_matter(self, tmp_path, monkeypatch):
        now = iter(range(2_000_000_000, 0, -1_000_000))
        monkeypatch.setattr("upslope.run.progress.time.time", lambda: float(next(now)))
        stop_at(tmp_path, 4)
        assert_same(walk(tmp_path, resume=True), walk())

    def test_leftovers_of_a_killed_save_are_swept(self, tmp_path):
        stop_at(tmp_path, 2)
        leftover = tmp_path / "checkpoints" / "learning" / "000000000004.safetensors.123.tmp"
        leftover.write_bytes(b"half")
        walk(tmp_path, resume=True)
        assert not leftover.exists()

    def test_a_state_that_is_not_finite_replaces_nothing(self, tmp_path):
        overflowing = walks([0.0, 3e38])
        with pytest.raises(UpslopeError, match=r"is not finite at update 2.*000000000001\.safetensors"):
            run(overflowing, KEYS[:2], updates=4, every=1, session=Session((), checkpoints(tmp_path)))
        assert [int(path.stem) for path in files(tmp_path)] == [1]

    def test_trouble_names_the_last_good_one(self, tmp_path):
        with pytest.raises(UpslopeError, match=r"at update 4 .*last good checkpoint is .*000000000003\.safetensors"):
            run(walks([0.0], breaks_at=4), KEYS[:1], updates=7, every=1, session=Session((), checkpoints(tmp_path)))

    @pytest.mark.parametrize("settings", [{"keep": 0}, {"every_seconds": 0.0}, {"every_updates": 0}])
    def test_settings_that_make_no_sense(self, tmp_path, settings):
        with pytest.raises(UpslopeError, match="Checkpoints need"):
            Checkpoints(tmp_path, **settings)


class TestDamage:
    @pytest.fixture
    def stopped(self, tmp_path):
        stop_at(tmp_path, 4)
        assert len(files(tmp_path)) == 2
        return tmp_path

    def damage(self, path):
        data = bytearray(path.read_bytes())
        data[-3] ^= 4
        path.write_bytes(data)

    def test_resuming_falls_back_with_a_warning(self, stopped):
        self.damage(files(stopped)[-1])
        with pytest.warns(UserWarning, match=r"damaged.*trying the one before"):
            again = walk(stopped, resume=True)
        assert_same(again, walk())

    def test_if_none_is_good_it_starts_again_and_keeps_what_it_saves(self, stopped):
        damaged = files(stopped)
        for file in damaged:
            self.damage(file)
        with pytest.warns(UserWarning, match="damaged"):
            stop_at(stopped, 2, resume=True)
        assert sorted(path.suffix for path in files(stopped)) == [".damaged"] * 2 + [".safetensors"] * 2
        assert max(int(path.stem) for path in files(stopped) if path.suffix == ".safetensors") < 4
        assert_same(walk(stopped, resume=True), walk())

    def test_asked_for_by_its_path_it_fails(self, stopped):
        newest = files(stopped)[-1]
        self.damage(newest)
        with pytest.raises(DamagedFileError, match=newest.name):
            walk(stopped, resume=newest)

    def test_a_prior_is_no_checkpoint(self, stopped, tmp_path):
        storage.write(tmp_path / "prior", "upslope-prior", 1, {}, {"a": np.zeros(1)})
        with pytest.raises(DamagedFileError, match="is not an upslope-checkpoint"):
            walk(stopped, resume=tmp_path / "prior")

    def test_other_settings_are_refused_and_shown(self, stopped):
        with pytest.raises(UpslopeError, match="updates was 7, is now 9"):
            walk(stopped, resume=True, updates=9)

    def test_other_inputs_are_refused(self, stopped):
        with pytest.raises(UpslopeError, match="inputs was"):
            walk(stopped, resume=True, drifts=(0.0, 1.0, 2.5))
        with pytest.raises(UpslopeError, match="inputs was"):
            walk(stopped, resume=True, keys=jax.random.split(jax.random.key(6), 3))

    def test_other_arrays_than_the_learners_have(self, stopped):
        newest = files(stopped)[-1]
        header, arrays, _ = storage.read(newest, "upslope-checkpoint", 1)
        for changed in (
            {**arrays, "states/extra": np.zeros(3)},
            {name: array for name, array in arrays.items() if name != "states/place"},
            {**arrays, "states/place": arrays["states/place"].astype(np.float64)},
            {**arrays, "states/key": arrays["states/key"][:2]},
        ):
            storage.write(newest, "upslope-checkpoint", 1, header, changed)
            with pytest.raises(DamagedFileError, match="does not hold what this run needs"):
                walk(stopped, resume=newest)

    def test_names_that_are_paths_stay_names(self, stopped):
        newest = files(stopped)[-1]
        header, arrays, _ = storage.read(newest, "upslope-checkpoint", 1)
        storage.write(newest, "upslope-checkpoint", 1, header, {**arrays, "../../outside": np.zeros(3)})
        before = sorted(stopped.rglob("*"))
        with pytest.raises(DamagedFileError):
            walk(stopped, resume=newest)
        assert sorted(stopped.rglob("*")) == before


class TestTrouble:
    def test_a_vanished_folder_is_an_error_at_the_next_save_with_the_outcome(self, tmp_path):
        folder = tmp_path / "run"
        folder.mkdir()

        def vanish():
            folder.rename(tmp_path / "elsewhere")
            folder.touch()

        with pytest.raises(NotSavedError, match="can't be written") as caught:
            walk(folder, observers=[Saboteur(4, vanish)])
        np.testing.assert_array_equal(caught.value.outcome.updates, [0, 2, 4])
        folder.unlink()
        (tmp_path / "elsewhere").rename(folder)
        assert_same(walk(folder, resume=True), walk())

    def test_a_full_disk_stops_the_run_and_leaves_the_checkpoint_before(self, tmp_path, monkeypatch):
        def fill():
            monkeypatch.setattr(storage, "milestone", _no_space)

        with pytest.raises(NotSavedError, match="No space left"):
            walk(tmp_path, observers=[Saboteur(4, fill)])
        monkeypatch.undo()
        assert max(int(path.stem) for path in files(tmp_path)) < 4
        assert_same(walk(tmp_path, resume=True), walk())

    def test_logs_that_cannot_be_written_cost_no_learning(self, tmp_path):
        def refuse():
            raise NotSavedError("The logs can't be written.")

        with pytest.raises(NotSavedError, match="logs"):
            walk(tmp_path, observers=[Saboteur(4, refuse)], every_updates=1000)
        assert [int(path.stem) for path in files(tmp_path)] == [4]


def _no_space(name):
    del name
    raise OSError(28, "No space left on device")


class TestSignals:
    @pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
    def test_they_stop_a_run_after_a_checkpoint(self, tmp_path, number):
        stop = stop_at(tmp_path, 4, number)
        assert stop.signal == number
        assert "stopped at update 4 of 7" in str(stop)
        assert "--resume" in str(stop)
        assert int(files(tmp_path)[-1].stem) == 4

    def test_handlers_that_were_there_are_put_back(self, tmp_path):
        heard = []
        previous = signal.signal(signal.SIGTERM, lambda number, frame: heard.append(number))
        try:
            stop_at(tmp_path, 2)
            assert heard == []
            signal.raise_signal(signal.SIGTERM)
            assert heard == [signal.SIGTERM]
        finally:
            signal.signal(signal.SIGTERM, previous)

    def test_without_checkpoints_signals_are_left_alone(self):
        # A shell that starts the tests in the background has them ignore Ctrl-C.
        previous = signal.signal(signal.SIGINT, signal.default_int_handler)
        try:
            with pytest.raises(KeyboardInterrupt):
                walk(observers=[Saboteur(2, send(signal.SIGINT))])
        finally:
            signal.signal(signal.SIGINT, previous)

    def test_outside_a_run_they_stop_at_once(self):
        with pytest.raises(InterruptedRunError, match="Stopped by SIGTERM"), stop_requests():
            signal.raise_signal(signal.SIGTERM)

    def test_other_threads_can_run_too(self, tmp_path):
        outcomes = []
        thread = threading.Thread(target=lambda: outcomes.append(walk(tmp_path)))
        thread.start()
        thread.join()
        assert_same(outcomes[0], walk())


@pytest.mark.slow
def test_a_potential_that_breaks_is_named_with_phase_and_step(tmp_path):
    class Breaking(eqx.Module):
        def __call__(self, obs):
            return jnp.where(jnp.abs(obs[0]) > 0.05, jnp.nan, 0.0)

    from upslope import train

    with pytest.raises(UpslopeError, match=r"DQN: (shaped_reward|reward|td_loss) of learner 0 is not a finite number"):
        train(POLES, POLES.sample(jax.random.key(0)), Breaking(), updates=50, every=25)


def test_golden_checkpoint_of_format_1(tmp_path):
    """Written by the first version that had checkpoints; every later version must continue from it."""
    golden = Path(__file__).parents[1] / "golden" / "checkpoint-format-1.safetensors"
    resumed, whole = walk(tmp_path, resume=golden), walk()
    np.testing.assert_allclose(resumed.states.place, whole.states.place, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(resumed.reports["return"], whole.reports["return"], rtol=1e-5, atol=1e-5)
    np.testing.assert_array_equal(resumed.states.steps, 7)
    assert (np.diff(resumed.seconds) > 0).all()
