"""Folders of runs: claimed by one process, never overwritten, resumed with the same settings only."""

import json
import multiprocessing
import os
import time
from pathlib import Path

import pytest

from upslope.errors import UpslopeError
from upslope.run.folder import claim, differences, summary


def claim_and_leave(folder, *args, **kwargs):
    with claim(folder, *args, **kwargs) as claimed_folder:
        return claimed_folder


class TestClaiming:
    def test_a_new_one_is_made(self, tmp_path):
        folder = claim_and_leave(tmp_path / "a" / "b", "test", {"rate": 0.5})
        assert folder == tmp_path / "a" / "b"
        description = json.loads((folder / "run.json").read_text())
        assert (description["kind"], description["configuration"]) == ("test", {"rate": 0.5})

    def test_an_empty_one_is_taken(self, tmp_path):
        assert claim_and_leave(tmp_path, "test") == tmp_path

    def test_one_that_holds_something_is_left_alone(self, tmp_path):
        (tmp_path / "precious").write_text("kept")
        with pytest.raises(UpslopeError, match="nothing is overwritten"):
            claim_and_leave(tmp_path, "test")
        assert [path.name for path in tmp_path.iterdir()] == ["precious"]

    def test_a_file_is_no_folder(self, tmp_path):
        (tmp_path / "file").write_text("kept")
        with pytest.raises(UpslopeError, match="nothing is overwritten"):
            claim_and_leave(tmp_path / "file", "test")

    def test_below_a_file_there_can_be_no_folder(self, tmp_path):
        (tmp_path / "file").write_text("kept")
        with pytest.raises(UpslopeError, match="can't be used as a folder"):
            claim_and_leave(tmp_path / "file" / "below", "test")

    def test_the_default_tells_kind_and_time(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        assert claim_and_leave(None, "figure").parent.name == "runs"
        assert [path.name.split("-")[0] for path in (tmp_path / "runs").iterdir()] == ["figure"]

    def test_errors_from_inside_are_not_blamed_on_the_folder(self, tmp_path):
        with pytest.raises(FileNotFoundError, match="elsewhere"), claim(tmp_path, "test"):
            Path("/elsewhere/file").read_text()


class TestResuming:
    def test_the_same_settings(self, tmp_path):
        claim_and_leave(tmp_path, "test", {"sizes": (3, 4)})
        assert claim_and_leave(tmp_path, "test", {"sizes": (3, 4)}, resume=True) == tmp_path

    def test_other_settings_are_refused_and_shown(self, tmp_path):
        claim_and_leave(tmp_path, "test", {"rate": 0.5, "deep": {"n": 1}})
        with pytest.raises(UpslopeError) as caught:
            claim_and_leave(tmp_path, "test", {"rate": 0.25, "deep": {"n": 2}}, resume=True)
        assert "configuration.rate was 0.5, is now 0.25" in str(caught.value)
        assert "configuration.deep.n was 1, is now 2" in str(caught.value)

    def test_another_kind_is_refused(self, tmp_path):
        claim_and_leave(tmp_path, "dqn")
        with pytest.raises(UpslopeError, match='kind was "dqn", is now "ddpg"'):
            claim_and_leave(tmp_path, "ddpg", resume=True)

    def test_a_folder_without_a_run(self, tmp_path):
        with pytest.raises(UpslopeError, match="There is no run in"):
            claim_and_leave(tmp_path, "test", resume=True)
        assert not list(tmp_path.iterdir())

    def test_no_folder_at_all(self):
        with pytest.raises(UpslopeError, match="--out"):
            claim_and_leave(None, "test", resume=True)

    @pytest.mark.parametrize("text", ["", "{", "[" * 100_000, "\xff"])
    def test_a_damaged_description(self, tmp_path, text):
        (tmp_path / "run.json").write_bytes(text.encode("latin-1"))
        with pytest.raises(UpslopeError, match="can't be read"):
            claim_and_leave(tmp_path, "test", resume=True)


def test_differences_are_named_by_place():
    assert differences({"a": 1, "b": [1, 2]}, {"a": 1, "b": [1, 3], "c": None}) == ["b was [1, 2], is now [1, 3]"]
    assert differences({"a": {"b": 1}}, {"a": {"b": 1}}) == []
    assert differences({"a": ["x", {"b": 1, "c": 2}]}, {"a": ["x", {"b": 1, "c": 3}]}) == ["a[1].c was 2, is now 3"]
    assert differences([{"a": 1}], [{"a": 1}, {"a": 2}]) == ['[1] was null, is now {"a": 2}']


class TestOneWriter:
    def test_the_second_learns_who_holds_it(self, tmp_path):
        with claim(tmp_path, "test"):
            began = time.monotonic()
            for resume in (False, True):
                with pytest.raises(UpslopeError, match=f"in use by process {os.getpid()} on"):
                    claim_and_leave(tmp_path, "test", resume=resume)
            assert time.monotonic() - began < 1

    def test_the_lock_goes_with_the_process(self, tmp_path):
        context = multiprocessing.get_context("spawn")
        process = context.Process(target=_hold_and_die, args=(tmp_path / "run",))
        process.start()
        process.join(60)
        assert process.exitcode == 7
        assert claim_and_leave(tmp_path / "run", "test", resume=True) == tmp_path / "run"


def _hold_and_die(folder):
    with claim(folder, "test"):
        os._exit(7)


def test_many_differences_are_summed_up():
    """As between the settings of two versions: the first ones are named, and the others counted."""
    there, here = ({f"setting{i}": i + start for i in range(9)} for start in (0, 1))
    found = differences(there, here)
    assert len(found) == 9
    assert summary(found[:3]) == "setting0 was 0, is now 1; setting1 was 1, is now 2; setting2 was 2, is now 3"
    assert summary(found).startswith("setting0 was 0, is now 1; setting1 was 1, is now 2; and 7 more")
