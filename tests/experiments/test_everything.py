"""`upslope reproduce all`: what is run, in which order, and the page that links to it."""

import json

import pytest
from rich.console import Console

from upslope.errors import UpslopeError
from upslope.experiments import everything
from upslope.experiments.catalogue import EXPERIMENTS


class Runs:
    """A fake `reproduce` that records its calls and writes what a chapter writes."""

    def __init__(self, fails_at=None):
        self.calls, self.priors_of, self.fails_at = [], {}, fails_at

    def __call__(self, name, *, out, is_quick, first_seed, priors_of, resume, console):
        self.calls.append((name, out.name, is_quick, first_seed, resume))
        self.priors_of[name] = priors_of and priors_of.name
        out.mkdir(exist_ok=True)
        (out / "run.json").write_text("{}")
        if name == self.fails_at:
            raise UpslopeError("stopped")
        (out / "results.json").write_text("{}")
        (out / "figure.png").write_bytes(b"")
        if name in ("fig2", "fig4"):
            for file in ("report.html", "maps.npz", "sheet.png"):
                (out / file).write_bytes(b"")
        console.print(f"{name} <found> 42")


@pytest.fixture
def runs(monkeypatch):
    runs = Runs()
    monkeypatch.setattr(everything, "reproduce", runs)
    return runs


def everything_in(folder, **settings):
    everything.reproduce_all(out=folder, console=Console(quiet=True), **settings)
    return (folder / "report.html").read_text(encoding="utf-8")


def test_every_figure_and_the_theorems_are_run_each_in_its_folder(runs, tmp_path):
    everything_in(tmp_path / "all", is_quick=True, first_seed=3)
    assert [call[0] for call in runs.calls] == [call[1] for call in runs.calls]
    assert {call[0] for call in runs.calls} == {"fig1", "fig2", "fig3", "fig4", "fig5", "theorems"} <= set(EXPERIMENTS)
    assert all(call[2:] == (True, 3, False) for call in runs.calls)


def test_figures_on_maps_begin_with_the_priors_that_are_there(runs, tmp_path):
    everything_in(tmp_path / "all")
    order = [call[0] for call in runs.calls]
    assert {name: given for name, given in runs.priors_of.items() if given} == {"fig3": "fig2", "fig5": "fig4"}
    assert order.index("fig2") < order.index("fig3")
    assert order.index("fig4") < order.index("fig5")


def test_the_page_links_what_is_there_and_quotes_what_was_said(runs, tmp_path):
    page = everything_in(tmp_path / "all")
    for name in everything.CHAPTERS:
        assert f"href='{name}/results.json'" in page
        assert f"src='{name}/figure.png'" in page
        assert f"{name} &lt;found&gt; 42" in page
        for file in ("report.html", "maps.npz", "sheet.png"):
            assert (f"href='{name}/{file}'" in page) == (name in ("fig2", "fig4"))
    assert "returns.npz" not in page
    assert "quick forms" not in page
    assert "quick forms" in everything_in(tmp_path / "quick", is_quick=True)


def test_it_goes_on_where_it_was_stopped(tmp_path, monkeypatch):
    stopped, again = Runs(fails_at="fig2"), Runs()
    monkeypatch.setattr(everything, "reproduce", stopped)
    with pytest.raises(UpslopeError, match="stopped"):
        everything_in(tmp_path / "all")
    assert "fig1" in (tmp_path / "all" / "report.html").read_text(encoding="utf-8")
    monkeypatch.setattr(everything, "reproduce", again)
    everything_in(tmp_path / "all", resume=True)
    begun = {name: resume for name, _, _, _, resume in again.calls}
    assert begun == {name: name in ("theorems", "fig1", "fig2") for name in everything.CHAPTERS}


def test_other_settings_are_another_run(runs, tmp_path):
    everything_in(tmp_path / "all")
    with pytest.raises(UpslopeError, match="first_seed"):
        everything_in(tmp_path / "all", resume=True, first_seed=1)
    assert json.loads((tmp_path / "all" / "run.json").read_text())["kind"] == "all"
