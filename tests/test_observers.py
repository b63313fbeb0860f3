"""What people see of a run: JSON lines, TensorBoard event files, the progress bar; and the folders it goes to."""

import io
import json

import numpy as np
import pytest
from rich.console import Console
from tensorboardX.proto.event_pb2 import Event

from upslope.errors import UpslopeError
from upslope.run.folder import claim
from upslope.run.observers import EventLog, ProgressBar

RETURNS = np.array([10.0, 20.0, 30.0, 40.0])
METRICS = {"td_loss": np.array([1.0, 2.0, 3.0, 6.0])}


def observe(observer, title="a run"):
    observer.begin(title, 100, 4)
    observer.record(0, RETURNS, METRICS)
    observer.record(100, RETURNS + 100, METRICS)
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
        return tmp_path / "new" / "run"

    def test_json_lines(self, folder):
        first, last = (json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines())
        # Quartiles of 10, 20, 30, 40 by linear interpolation; the mean of 1, 2, 3, 6.
        assert first == {
            "run": "a run", "learners": 4, "update": 0, "return/median": 25.0, "return/lower_quartile": 17.5,
            "return/upper_quartile": 32.5, "metrics/td_loss": 3.0,
        }  # fmt: skip
        assert (last["update"], last["return/median"]) == (100, 125.0)

    def test_tensorboard_events_hold_the_same_numbers(self, folder):
        (events,) = (folder / "events" / "a_run").iterdir()
        scalars = scalars_of(events)
        assert ("return/median", 0, 25.0) in scalars
        assert ("return/median", 100, 125.0) in scalars
        assert ("metrics/td_loss", 100, 3.0) in scalars
        assert len(scalars) == 8

    def test_several_runs_share_one_file_of_lines(self, folder):
        observe(EventLog(folder), title="another run")
        runs = [json.loads(line)["run"] for line in (folder / "metrics.jsonl").read_text().splitlines()]
        assert runs == ["a run"] * 2 + ["another run"] * 2
        assert {path.name for path in (folder / "events").iterdir()} == {"a_run", "another_run"}


def test_the_progress_bar_shows_title_share_and_median():
    output = io.StringIO()
    observe(ProgressBar(Console(file=output, width=200, force_terminal=True)))
    text = output.getvalue()
    assert "a run" in text
    assert "100%" in text
    assert "return 125.0" in text


class TestFolders:
    def test_a_new_one_is_made(self, tmp_path):
        folder = claim(tmp_path / "a" / "b", "test")
        assert folder == tmp_path / "a" / "b"
        assert folder.is_dir()

    def test_an_empty_one_is_taken(self, tmp_path):
        assert claim(tmp_path, "test") == tmp_path

    def test_one_that_holds_something_is_left_alone(self, tmp_path):
        (tmp_path / "precious").write_text("kept")
        with pytest.raises(UpslopeError, match="nothing is overwritten"):
            claim(tmp_path, "test")
        assert (tmp_path / "precious").read_text() == "kept"

    def test_a_file_is_no_folder(self, tmp_path):
        (tmp_path / "file").write_text("kept")
        with pytest.raises(UpslopeError, match="nothing is overwritten"):
            claim(tmp_path / "file", "test")

    def test_below_a_file_there_can_be_no_folder(self, tmp_path):
        (tmp_path / "file").write_text("kept")
        with pytest.raises(UpslopeError, match="can't be used as a folder"):
            claim(tmp_path / "file" / "below", "test")

    def test_the_default_tells_kind_and_time(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        assert claim(None, "figure").parent.name == "runs"
        assert [path.name.split("-")[0] for path in (tmp_path / "runs").iterdir()] == ["figure"]
