"""The registry of experiments: how options change settings, what is refused, and how one is reproduced."""

import io
import json
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from rich.console import Console

from upslope.errors import UpslopeError
from upslope.experiments.catalogue import EXPERIMENTS, reproduce
from upslope.experiments.experiment import Experiment, Options
from upslope.experiments.maps.readings import training_title
from upslope.experiments.results import write_json

OF_MAPS = {"fig2", "fig3", "fig4", "fig5", "grid-readings", "grid-precisions"}
PANELS = {"fig1": ("left", "middle", "right"), "fig3": ("left", "right"), "fig5": ("left", "right")}


def planned(name, **options):
    return EXPERIMENTS[name].plan(name, Options(**options))


@pytest.mark.parametrize("is_quick", [False, True])
@pytest.mark.parametrize("name", EXPERIMENTS)
class TestSettings:
    def test_counts_asked_for_are_those_of_the_run(self, name, is_quick):
        own = EXPERIMENTS[name].full().first_seed
        settings = planned(name, is_quick=is_quick, seeds=3, tasks=7, first_seed=4).settings
        assert (settings.seeds, settings.tasks, settings.first_seed) == (3, 7, own + 4)

    def test_nothing_asked_for_changes_nothing(self, name, is_quick):
        experiment = EXPERIMENTS[name]
        full = experiment.full()
        assert planned(name, is_quick=is_quick).settings == (experiment.quick(full) if is_quick else full)

    def test_the_description_is_plain_and_names_the_panels_of_a_figure(self, name, is_quick):
        described = json.loads(json.dumps(planned(name, is_quick=is_quick).description()))
        assert tuple(described.pop("panels", ())) == PANELS.get(name, ())
        assert {"seeds", "tasks", "first_seed"} <= described.keys()


@pytest.mark.parametrize("name", EXPERIMENTS)
class TestRefusals:
    def test_iterations_where_their_number_is_fixed(self, name):
        if name in OF_MAPS:
            assert planned(name, iterations=50).settings != planned(name).settings
        else:
            with pytest.raises(UpslopeError, match=f"{name} has a fixed number of iterations"):
                planned(name, iterations=50)

    def test_priors_where_none_are_shared(self, name):
        if name in ("fig3", "fig5"):
            assert len(planned(name, priors_of=Path("there")).trainings) == 2
        else:
            with pytest.raises(UpslopeError, match=f"{name} takes no priors of another figure"):
                planned(name, priors_of=Path("there"))

    @pytest.mark.parametrize("options", [{"seeds": 0}, {"tasks": -1}])
    def test_counts_below_one(self, name, options):
        with pytest.raises(UpslopeError, match=r"(seeds|tasks|iterations) are too few: give at least 1"):
            planned(name, **options)

    def test_no_panels(self, name):
        with pytest.raises(UpslopeError, match=r"leave out --panels|needs at least one panel: choose from left"):
            planned(name, panels=())


def test_panels_are_made_as_they_are_asked_for():
    assert planned("fig1", panels=("right", "middle")).panels == ("right", "middle")
    assert planned("fig3", panels=("right", "left")).panels == ("right", "left")
    assert planned("fig3").panels == ("left", "right")
    for asked in (("middle",), ("right", "middle")):
        with pytest.raises(UpslopeError, match="fig3 has no middle panel: choose from left, right"):
            planned("fig3", panels=asked)
    assert planned("deviations").panels == ()
    with pytest.raises(UpslopeError, match="deviations has no panels: leave out --panels"):
        planned("deviations", panels=("right",))


@pytest.mark.parametrize(("figure", "begins_as"), [("fig3", "fig2"), ("fig5", "fig4")])
def test_figures_on_maps_share_all_trainings_of_the_one_before(figure, begins_as):
    before = planned(begins_as).settings
    assert set(planned(figure).trainings) == {training_title(before.maps, reading) for reading in before.readings}
    assert planned(figure, panels=("left",)).trainings == (training_title(before.maps, "algorithm1"),), "no control"


@dataclass(frozen=True)
class Settings:
    """Settings of the experiment below."""

    seeds: int = 2
    tasks: int = 5
    first_seed: int = 0


@pytest.fixture
def sessions(monkeypatch):
    """The sessions of an experiment that computes nothing; "stub" can reuse priors."""
    seen = []

    def run(plan, session):
        seen.append(session)
        return {"seeds": plan.settings.seeds}

    stub = Experiment(
        Settings,
        quick=lambda settings: replace(settings, tasks=1),
        run=run,
        write=lambda results, folder: write_json(folder / "results.json", results),
        summarise=lambda results, folder, console: console.print(results["seeds"], "seeds in", folder.name),
        trainings=lambda *_: ("a training",),
    )
    monkeypatch.setitem(EXPERIMENTS, "stub", stub)
    return seen


def test_it_is_run_written_and_summarised(sessions, tmp_path):
    console = Console(record=True, file=io.StringIO())
    reproduce("stub", out=tmp_path / "out", is_quick=True, seeds=3, first_seed=1, console=console)
    described = json.loads((tmp_path / "out" / "run.json").read_text())
    assert described["kind"] == "stub"
    assert described["configuration"] == {"seeds": 3, "tasks": 1, "first_seed": 1}
    assert json.loads((tmp_path / "out" / "results.json").read_text()) == {"seeds": 3}
    assert "3 seeds in out" in console.export_text()
    (session,) = sessions
    assert not session.checkpoints.resume
    assert not session.checkpoints.final_states


def test_what_can_be_seen_before_the_end_is_shown_where_progress_is(sessions, tmp_path, monkeypatch, capsys):
    def run(plan, session):
        session.show({"so far": 1})
        return {"seeds": 2}

    def show(results, folder, console):
        console.print(results["so far"], "of it in", folder.name)

    silent = replace(EXPERIMENTS["stub"], run=run)
    monkeypatch.setitem(EXPERIMENTS, "silent", silent)
    monkeypatch.setitem(EXPERIMENTS, "shown", replace(silent, show=show))
    for name, said in (("silent", ""), ("shown", "1 of it in shown\n")):
        summary = Console(record=True, file=io.StringIO())
        reproduce(name, out=tmp_path / name, console=summary)
        assert capsys.readouterr().err == said
        assert summary.export_text() == f"2 seeds in {name}\n"


def test_it_goes_on_with_the_same_settings_only(sessions, tmp_path):
    for resume in (False, True):
        reproduce("stub", out=tmp_path, resume=resume, console=Console(quiet=True))
    assert [session.checkpoints.resume for session in sessions] == [False, True]
    with pytest.raises(UpslopeError, match="seeds was 2, is now 4"):
        reproduce("stub", out=tmp_path, resume=True, seeds=4, console=Console(quiet=True))


def test_it_begins_with_the_trainings_of_another_run(sessions, tmp_path):
    kept = tmp_path / "before" / "checkpoints" / "a_training" / "0.safetensors"
    kept.parent.mkdir(parents=True)
    kept.write_bytes(b"kept")
    reproduce("stub", out=tmp_path / "out", priors_of=tmp_path / "before", console=Console(quiet=True))
    assert (tmp_path / "out" / "checkpoints" / "a_training" / "0.safetensors").read_bytes() == b"kept"
    assert sessions[0].checkpoints.resume
    with pytest.raises(UpslopeError, match="holds no training called 'a training'"):
        reproduce("stub", out=tmp_path / "other", priors_of=tmp_path / "out2", console=Console(quiet=True))
