"""What the benchmark of the first figure sees of a process that draws one."""

import sys

import pytest
from benchmarks.first_figure import CLONE, COMPUTING, FIRST, FIRST_PICTURE, INSTALL, SECOND, bars, watched

from benchmarks import first_figure

#: Draws twice, as a figure does after its first panel and at its end.
DRAWING = """
import json, pathlib, sys, time
folder = pathlib.Path("runs") / sys.argv[1]
folder.mkdir(parents=True)
for wait in (0.1, 0.8):
    time.sleep(wait)
    (folder / "figure.png").write_bytes(b"")
(folder / "results.json").write_text(json.dumps({"seconds_compiling": 2.0, "seconds_running": 6.0}))
"""


def test_the_first_picture_is_not_taken_for_the_last_one_or_for_an_earlier_run_s(tmp_path):
    for name in ("one", "two"):
        row = watched([sys.executable, "-c", DRAWING, name], tmp_path / "runs", tmp_path / "cache", tmp_path)
        assert 0.1 < row[FIRST_PICTURE] < row["median"] - 0.5
        assert row[COMPUTING] == 8


def test_a_process_that_fails_ends_the_benchmark(tmp_path):
    with pytest.raises(SystemExit, match="failed with 3"):
        watched([sys.executable, "-c", "raise SystemExit(3)"], tmp_path, tmp_path, tmp_path)


def test_the_bars_add_up_what_a_user_waits_for_and_say_what_bounds_a_second_run():
    run = {"median": 200.0, FIRST_PICTURE: 90.0, COMPUTING: 180.0, "compiling": 18.0}
    again = run | {COMPUTING: 165.0, "compiling": 5.0}
    rows = {CLONE: {"median": 1.0}, INSTALL: {"median": 30.0}, FIRST: run, SECOND: again}
    picture, second, quick = bars(rows)
    assert picture.measured == 121
    assert picture.verdict == "met"
    assert second.measured == pytest.approx(165 / 180)
    assert "10% of the first run's" in second.bound
    assert quick.verdict == "not measured"


def test_all_that_is_in_a_folder_counts(tmp_path):
    (tmp_path / "inner").mkdir()
    (tmp_path / "inner" / "file").write_bytes(bytes(2**20))
    assert first_figure.mebibytes(tmp_path) == 1
