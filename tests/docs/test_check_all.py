"""The complete check: what is stored of a run, and the README's line that shows it."""

import json
import sys

import pytest
from checks.__main__ import Options, main
from checks.jobs import Job, all_jobs, counts, run
from checks.record import ROOT, STORED, line, readme_with, record, write

JUNIT = '<testsuites><testsuite tests="9" failures="1" errors="1" skipped="2"/></testsuites>'


def python(code, **settings):
    return Job("a job", (sys.executable, "-c", code), **settings)


def test_the_readme_shows_the_stored_result():
    """Run `make check-all`; it writes both."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert readme_with(text, STORED) == text


@pytest.mark.parametrize(("code", "passed"), [("", True), ("raise SystemExit(3)", False)])
def test_a_job_passes_by_its_exit_code(code, passed, tmp_path):
    assert run(python(code), tmp_path)["passed"] is passed


@pytest.mark.parametrize(("code", "passed"), [("open('a', 'w').write('x')", True), ("open('a', 'w')", False)])
def test_and_by_the_files_that_it_writes(code, passed, tmp_path):
    assert run(python(code, files=(tmp_path / "a",)), tmp_path)["passed"] is passed


def test_tests_are_counted(tmp_path):
    (tmp_path / "report.xml").write_text(JUNIT)
    assert counts(tmp_path / "report.xml") == {"passed": 5, "failed": 2, "skipped": 2}


def test_a_result_and_its_line(tmp_path):
    good = {"name": "reliability", "passed": True, "minutes": 15.5}
    tests = {"name": "tests", "passed": True, "minutes": 60.0, "tests": {"passed": 2480, "failed": 0, "skipped": 3}}
    path = tmp_path / "check-all.json"
    assert "no stored result yet" in line(path)
    content = record("abc", [good, tests])
    write(content, path)
    assert json.loads(path.read_text()) == content
    assert (content["minutes"], content["commit"]) == (75.5, "abc")
    assert set(content["machine"]) == {"cores", "system"}
    assert "all 2 jobs passed (2,480 tests, 76 minutes" in line(path)
    write(record("abc", [good | {"passed": False}, tests]), path)
    assert "failed: reliability (2,480 tests" in line(path)


def test_a_part_stores_nothing(monkeypatch, tmp_path):
    monkeypatch.setattr("checks.__main__.all_jobs", lambda folder: [python("")])
    monkeypatch.setattr("checks.__main__.STORED", tmp_path / "check-all.json")
    assert main(Options(only="a job")) == 0
    assert not list(tmp_path.iterdir())


def test_every_slow_test_and_example_is_in_it(tmp_path):
    names = {job.name: job.command for job in all_jobs(tmp_path)}
    assert names.keys() == {"Figure 1, quick form", "Tianshou example", "reliability", "tests, fast and slow"}
    marks = names["tests, fast and slow"]
    assert marks[marks.index("-m", 3) + 1] == "", "an empty expression selects slow tests too"
