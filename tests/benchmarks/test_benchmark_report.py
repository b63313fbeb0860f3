"""The benchmarks' harness and the page that is written from their results."""

import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
from benchmarks.harness import Bar, Options, Part, cells_of, number, time_in_turns, write

from benchmarks import harness, report


class TestTiming:
    def test_parts_take_turns_and_the_first_call_is_reported_separately(self):
        calls = []
        parts = {name: Part(lambda name=name: calls.append(name), {"things": 6}) for name in "ab"}
        rows = time_in_turns(parts, 3)
        assert calls == ["a", "b", "a", "b", "a", "b", "a", "b"]
        assert len(rows["a"]["seconds"]) == 3
        assert rows["a"]["things/s"] == pytest.approx(6 / rows["a"]["median"])

    def test_after_each_turn_it_reports_how_many_calls_each_part_has_had(self):
        calls, reported = [], []
        parts = {name: Part(lambda name=name: calls.append(name)) for name in "ab"}
        time_in_turns(parts, 2, lambda count: reported.append((count, len(calls))))
        assert reported == [(1, 2), (2, 4), (3, 6)]

    def test_it_measures_wall_clock_seconds(self):
        row = time_in_turns({"nap": Part(lambda: time.sleep(0.02))}, 2)["nap"]
        assert 0.02 <= row["fastest"] <= row["median"] <= row["slowest"] < 2
        assert row["first_call"] >= 0.02
        assert row["compiling"] == 0

    def test_compiling_is_counted_in_the_first_call_only(self):
        import jax
        import jax.numpy as jnp

        program = jax.jit(lambda x: x * 3 + 1)
        row = time_in_turns({"program": Part(lambda: program(jnp.ones(7)).block_until_ready())}, 2)["program"]
        assert row["programs"] >= 1
        assert 0 < row["compiling"] <= row["first_call"] * 1.01


class TestBars:
    @pytest.mark.parametrize(
        ("measured", "at_most", "verdict"),
        [
            (120.0, False, "met"),
            (100.0, False, "met"),
            (50.0, False, "missed by a factor of 2.00"),
            (50.0, True, "met"),
            (150.0, True, "missed by a factor of 1.50"),
            (None, False, "not measured"),
        ],
    )
    def test_verdict(self, measured, at_most, verdict):
        assert Bar("", measured, 100, at_most).verdict == verdict


def test_what_limits_a_bar_that_is_met_within_the_noise_is_reported():
    bars = [Bar("near", 1.05, 1.1, True, "the caches", close=True)._asdict(), Bar("far", 2, 1, bound="rain")._asdict()]
    page = report.bars_table([bar | {"verdict": "met"} for bar in bars])
    assert "| near | 1.05 | met | the caches |" in page
    assert "| far | 2.00 | met |  |" in page


def test_a_scratch_folder_goes_with_its_process(tmp_path):
    program = "from benchmarks import harness; print(harness.scratch())"
    environment = os.environ | {"TMPDIR": str(tmp_path)}
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, cwd=report.ROOT, env=environment, check=True, capture_output=True, text=True)
    assert Path(done.stdout.strip()).parent == tmp_path
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("value", "text"),
    [(1234567.0, "1,234,567"), (12.345, "12.3"), (0.0123456, "0.0123"), (0, "0"), (3, "3.00"), ("words", "words")],
)
def test_three_digits(value, text):
    assert number(value) == text


def test_a_table_has_every_number_of_every_row():
    rows = {"a": {"median": 1.0, "fastest": 0.5, "slowest": 2.0, "rate/s": 7.0}, "b": {"median": 3.0, "MiB": 9.0}}
    heads, body = cells_of(rows, "s")
    assert heads == ["", "median, s", "range, s", "rate/s", "MiB"]
    assert body == [["a", "1.00", "0.500 to 2.00", "7.00", ""], ["b", "3.00", "", "", "9.00"]]


@pytest.mark.parametrize("quick", [True, False])
def test_results_say_what_they_were_made_with_and_quick_ones_stay_apart(quick, tmp_path, monkeypatch):
    monkeypatch.setattr(harness, "RESULTS", tmp_path)
    rows = {"a": harness.spread([1.0, 2.0, 9.0])}
    path = write("maps", Options(quick=quick), rows, bars=[Bar("low", 2.0, 1.0, bound="the weather")])
    assert path == (tmp_path / "quick" if quick else tmp_path) / "maps.json"
    content = json.loads(path.read_text())
    assert content["rows"]["a"] == {"median": 2.0, "fastest": 1.0, "slowest": 9.0}
    assert content["bars"][0]["verdict"] == "met"
    assert content["settings"] == {"repeats": 5, "quick": quick}
    assert {"jax", "upslope"} <= set(content["versions"])
    assert content["hardware"]["cores"] >= 1
    assert "devices" not in content["hardware"]
    assert len(content["versions"].get("commit", 40 * "0").split(",")[0]) == 40
    pages = report.pages(report.results(path.parent))
    assert "| a | 2.00 | 1.00 to 9.00 |" in pages["performance/maps.md"]
    everything = "".join(pages.values())
    assert everything.count("| low | 2.00 | met |  |") == 1
    assert everything.count("Not measured yet.") == len(report.SECTIONS) - 1
    assert "1 of 1 met" in pages["performance.md"]


DOCS = report.ROOT / "docs"
PAGES = report.pages(report.results(harness.RESULTS))


@pytest.mark.parametrize("path", PAGES)
def test_a_page_is_generated_from_the_results(path):
    """Run `python -m benchmarks.report` after a benchmark, or after a change to benchmarks/notes."""
    assert (DOCS / path).read_text(encoding="utf-8") == PAGES[path]


def test_there_are_no_other_pages_and_no_dead_links():
    assert {f"performance/{page.name}" for page in DOCS.glob("performance/*.md")} == PAGES.keys() - {"performance.md"}
    for path, text in PAGES.items():
        for target in re.findall(r"\]\(([^)#]+)\)", text):
            assert ((DOCS / path).parent / target).is_file(), f"{path} links to {target}"


def test_the_first_page_fits_on_a_screen():
    assert PAGES["performance.md"].count("\n") <= 60


def test_every_benchmark_has_notes():
    written = {path.stem for path in report.NOTES.glob("*.md")} - {"introduction", "more", "tried"}
    assert written == {section.name for section in report.SECTIONS}
