"""Reports of Figures 3 and 5 follow from their numbers; no learning is needed here."""

import io
import json
import re
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from rich.console import Console

from upslope import storage
from upslope.errors import NotSavedError
from upslope.experiments.adaptation_panel import RULES
from upslope.experiments.figures import figure_on
from upslope.experiments.plots import draw
from upslope.experiments.report import columns, findings, panel_rows, print_summary, write_report
from upslope.experiments.results import SUCCESS, Arm, FigureResult, Panel, make_arm, write_results

ARMS = ["unshaped", "constant", "prior", "prior_ensemble", "prior_unzeroed", "multi_task_dqn", "manhattan", "oracle"]
LESS = {"unshaped": {"mean": 0.5, "low": 0.42, "high": 0.58}, "oracle": {"mean": -0.021, "low": -0.03, "high": -0.01}}
BELOW = {"percent": 3.42, "low": -0.5, "high": 7.1, "of_seeds": [5.2, -1.94]}
UPDATES = np.array([0, 25, 50])


def arm(solved, notes=None) -> Arm:
    """The numbers of solved maps, of ten, at each evaluation, for one seed; a solved map returns 0.5, discounted."""
    returns = (np.arange(10)[None, :, None] < np.asarray(solved)[None, None, :]).astype(np.float32)
    return make_arm(UPDATES, {"return": returns, "discounted_return": returns / 2}, SUCCESS, notes)


@pytest.fixture(scope="module")
def result() -> FigureResult:
    right = {name: arm([0, 2, 4]) for name in ARMS} | {"prior": arm([0, 6, 9]), "unshaped": arm([0, 0, 0])}
    left = {name: arm([5, 5, 5], {"step_size": 0.1}) for name in RULES} | {"algorithm2": arm([5, 7, 8])}
    panels = {
        "left": Panel("Adaptation", left, 1.0, 2.0, variants={"10": left, "20": left}),
        "right": Panel("Shaping only: DQN", right, 1.0, 2.0, notes={"prior_less": LESS, "percent_below_oracle": BELOW}),
    }
    prior = {"zero_shot_mean": 0.5, "rank_correlation": 0.9}
    control = {f"multi_task_{name}": value / 2 for name, value in prior.items()}
    rows = [{"seed": 0, "iterations": 2000, **prior, **control}]
    training = {"iterations": np.array([0, 10, 20]), "returns": np.array([[0.0, 0.25, 0.5]])}
    return FigureResult("fig5", panels, rows, training, {"first_seed": 0}, False, 2.0, 4.0)


def test_the_table_has_success_with_two_digits_and_the_first_update_that_solves_most(result):
    rows = {row[0]: row[1:] for row in panel_rows(result.panels["right"])}
    assert rows["meta-learned prior"] == ("0.00", "1.00", "1.00", "0.500", "0.556 (0.556 to 0.556)", "25")
    assert rows["no shaping"] == ("0.00", "0.00", "0.00", "0.000", "0.000 (0.000 to 0.000)", "never")
    assert len(columns(SUCCESS)) == 1 + len(rows["no shaping"])


def test_numbers_stay_whole_in_a_narrow_terminal(result):
    console = Console(record=True, file=io.StringIO(), width=80)
    print_summary(result, console)
    text = console.export_text()
    assert "meta-learned prior         0.00  1.00 1.00     0.500 0.556 (0.556–0.556) 25" in text
    assert "…" not in text


def numbers_in(sentence):
    """All numbers of a sentence, as they are written."""
    return re.findall(r"−?\d[\d,]*(?:\.\d+)?", sentence)


def test_findings(result):
    priors, left, right, differences, below = findings(result)
    assert numbers_in(priors) == ["2,000", "0.50", "0.25", "0.90", "0.45"]
    assert "25 with Algorithm 2, never with MAML" in left
    assert "the paper" not in left
    assert numbers_in(right) == ["0.50", "0.00", "0.20", "2.50"] + ["0.20"] * 4
    assert "no shaping 0.500 (0.420 to 0.580); oracle −0.021 (−0.030 to −0.010)." in differences
    assert numbers_in(below) == ["3.4", "−0.5", "7.1", "−1.9", "5.2"]
    without = replace(result.panels["right"], notes={})
    assert len(findings(replace(result, panels={"right": without}))) == 2


def test_results_hold_every_measure(result, tmp_path):
    write_results(result, tmp_path)
    entry = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))["panels"]["right"]["arms"]["prior"]
    assert entry["first_median_solved"] == 25
    assert entry["discounted_return"]["median"] == [0.0, 0.5, 0.5]
    assert entry["mean_over_evaluations"] == pytest.approx(0.5)
    # Maps 0 to 5 succeed at two of the three evaluations, 6 to 8 at one, and 9 at none. The middle half of ten runs
    # is what remains after trimming two at each end.
    np.testing.assert_allclose(entry["iqm_of_means"], [(2 * 4 + 1 * 2) / 3 / 6] * 3, rtol=1e-5)
    returns = np.load(tmp_path / "returns.npz")
    np.testing.assert_array_equal(returns["right/prior"], result.panels["right"].arms["prior"].returns)
    np.testing.assert_array_equal(returns["right/prior/discounted_return"], returns["right/prior"] / 2)


class TestBeforeTheEnd:
    @pytest.fixture
    def half(self, result) -> FigureResult:
        return replace(result, panels={"right": result.panels["right"]}, pending=("left",))

    def seen(self, half, folder) -> str:
        console = Console(record=True, file=io.StringIO(), width=40)
        assert figure_on("obstacles").show is not None
        figure_on("obstacles").show(half, folder, console)
        return console.export_text()

    def test_the_picture_grows(self, result, half, tmp_path):
        assert self.seen(half, tmp_path) == f"The right panel is done: {tmp_path / 'figure.png'} shows it.\n"
        assert [path.name for path in tmp_path.iterdir()] == ["figure.png"], "nothing that looks finished"
        before = plt.imread(tmp_path / "figure.png")[..., :3]
        draw(result, tmp_path)
        after = plt.imread(tmp_path / "figure.png")[..., :3]
        assert before.shape == after.shape
        height, width = before.shape[0] // 3, before.shape[1] // 2
        ink = [(1 - picture[:height, :width]).mean() for picture in (before, after)]
        assert 0 < ink[0] < ink[1] / 4, "there is room for the left panel, and next to nothing in it"

    def test_a_finished_figure_keeps_its_picture(self, half, tmp_path):
        (tmp_path / "results.json").write_text("{}")
        (tmp_path / "figure.png").write_bytes(b"whole")
        assert self.seen(half, tmp_path) == ""
        assert (tmp_path / "figure.png").read_bytes() == b"whole"

    def test_an_older_picture_outlives_a_full_disk(self, half, tmp_path, monkeypatch):
        (tmp_path / "figure.png").write_bytes(b"older")

        def pull_the_plug(name):
            if name == "inside the temporary file":
                raise OSError(28, "No space left on device")

        monkeypatch.setattr(storage, "milestone", pull_the_plug)
        with pytest.raises(NotSavedError, match=r"figure\.png can't be written"):
            self.seen(half, tmp_path)
        assert (tmp_path / "figure.png").read_bytes() == b"older"


@pytest.mark.parametrize("panels", [["left", "right"], ["right"], ["left"]])
def test_pictures_and_page_of_any_panels(result, panels, tmp_path):
    part = FigureResult(**{**result.__dict__, "panels": {name: result.panels[name] for name in panels}})
    draw(part, tmp_path)
    write_report(part, tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Figure 5: unseen maps with obstacles" in page
    assert "1 seeds × 10 maps" in page
    assert page.count("<table>") == len(panels)
    assert ("oracle −0.021 (−0.030 to −0.010)" in page) == ("right" in panels)
    assert ("<td>0.556 (0.556 to 0.556)</td>" in page) == ("right" in panels)
    print_summary(part, Console(quiet=True))
