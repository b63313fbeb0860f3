"""What people see of a run: JSON lines, TensorBoard event files, the progress bar."""

import io
import json

import numpy as np
import pytest
from rich.console import Console
from tensorboardX.proto.event_pb2 import Event

from upslope.errors import NotSavedError
from upslope.run.observers import EventLog, ProgressBar

RETURNS = np.array([10.0, 20.0, 30.0, 40.0])
METRICS = {"td_loss": np.array([1.0, 2.0, 3.0, 6.0])}


def observe(observer, title="a run"):
    observer.begin(title, 100, 4)
    observer.record(0, RETURNS, METRICS, at=1000.5)
    observer.record(100, RETURNS + 100, METRICS, at=1001.5)
    observer.end()


def scalars_of(path):
    """(name, step, value) of every scalar in a TensorBoard event file, read record by record."""
    data, found = path.read_bytes(), []
    while data:
        length = int.from_bytes(data[:8], "little")  # length, its checksum, the record, the record's checksum
        event = Event.FromString(data[12 : 12 + length])
        found += [(value.tag, event.step, value.simple_value) for value in event.summary.value]
        data = data[16 + length :]
    return found


class TestEventLog:
    @pytest.fixture
    def folder(self, tmp_path):
        observe(EventLog(tmp_path / "new" / "run"))
        return tmp_path / "new" / "run" / "a_run"

    def test_json_lines(self, folder):
        first, last = (json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines())
        # Quartiles of 10, 20, 30, 40 by linear interpolation; the mean of 1, 2, 3, 6.
        assert first == {
            "run": "a run", "learners": 4, "update": 0, "at": 1000.5, "return/median": 25.0,
            "return/lower_quartile": 17.5, "return/upper_quartile": 32.5, "metrics/td_loss": 3.0,
        }  # fmt: skip
        assert (last["update"], last["return/median"]) == (100, 125.0)

    def test_tensorboard_events_hold_the_same_numbers(self, folder):
        (events,) = folder.glob("events*")
        scalars = scalars_of(events)
        assert ("return/median", 0, 25.0) in scalars
        assert ("return/median", 100, 125.0) in scalars
        assert ("metrics/td_loss", 100, 3.0) in scalars
        assert len(scalars) == 8

    def test_each_run_has_a_folder(self, folder):
        observe(EventLog(folder.parent), title="another run")
        assert {path.name for path in folder.parent.iterdir()} == {"a_run", "another_run"}

    def test_a_repeated_run_leaves_no_duplicates(self, folder):
        before = (folder / "metrics.jsonl").read_text()
        observe(EventLog(folder.parent))
        assert (folder / "metrics.jsonl").read_text() == before
        (events,) = folder.glob("events*")
        assert len(scalars_of(events)) == 8

    def test_a_folder_that_cannot_be_written_is_an_error(self, tmp_path):
        (tmp_path / "file").write_text("no folder")
        with pytest.raises(NotSavedError, match="can't be written"):
            EventLog(tmp_path / "file").begin("a run", 100, 4)


def test_the_progress_bar_shows_title_share_and_median():
    output = io.StringIO()
    observe(ProgressBar(Console(file=output, width=200, force_terminal=True)))
    text = output.getvalue()
    assert "a run" in text
    assert "100%" in text
    assert "return 125.0" in text
