"""Pictures of maps: every number, colour and arrow is in its cell."""

from typing import ClassVar

import jax
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import to_rgba
from matplotlib.quiver import Quiver

from upslope.envs.grid import GridGame, read_map
from upslope.envs.grid_rules import DOWN, RIGHT
from upslope.experiments.maps.plots import (
    GOAL_COLOUR,
    START_COLOUR,
    TRAP_COLOUR,
    WALL_COLOUR,
    caption,
    draw_arrows,
    draw_map,
    draw_one,
    draw_sheet,
    draw_values,
    figure_of_one,
    figure_of_sheet,
    learned_maps,
    spread_by_rank,
)
from upslope.networks.dueling import DuelingQ
from upslope.planning.measures import truths

ONE = read_map("""
    S.#
    T.G
""")
GAME = GridGame(2, 3, traps=True, flat=True)


@pytest.fixture(autouse=True)
def without_a_screen():
    matplotlib.use("agg")
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def network():
    return DuelingQ(jax.random.key(0), GAME.observation_shape[0], 4, (8,))


@pytest.fixture(scope="module")
def learned(network):
    maps = jax.tree.map(lambda leaf: leaf[None], ONE)
    return learned_maps(GAME, truths(GAME, maps, 0.9), maps, network, 50)[0]


def colour_of_cells(axis):
    """Colours of the filled rectangles by (row, column)."""
    return {
        (round(patch.get_y() + 0.5), round(patch.get_x() + 0.5)): patch.get_facecolor()
        for patch in axis.patches
        if patch.get_fill()
    }


def arrows_on(axis):
    """Steps of the arrows by (column, row); empty without arrows."""
    of_axis = [child for child in axis.get_children() if isinstance(child, Quiver)]
    return {(x, y): (u, v) for one in of_axis for x, y, u, v in zip(*one.XY.T, one.U, one.V, strict=True)}


def shown_on(axis):
    """The numbers behind the one image of an axis."""
    (image,) = axis.images
    return np.ma.filled(image.get_array().astype(float), np.nan)


def test_a_map_shows_everything_in_its_cell():
    axis = plt.figure().add_subplot()
    draw_map(axis, ONE)
    assert colour_of_cells(axis) == {
        (0, 0): to_rgba(START_COLOUR),
        (0, 2): to_rgba(WALL_COLOUR),
        (1, 0): to_rgba(TRAP_COLOUR),
        (1, 2): to_rgba(GOAL_COLOUR),
    }


def test_a_heat_map_shows_the_cells_that_count(learned):
    axis = plt.figure().add_subplot()
    shown = np.ma.filled(draw_values(axis, learned, learned.optimal_value, limits=(0.0, 1.0)).get_array(), np.nan)
    np.testing.assert_allclose(shown, [[0.81, 0.9, np.nan], [np.nan, 1.0, np.nan]], rtol=1e-6)
    assert colour_of_cells(axis)[1, 2] == to_rgba(GOAL_COLOUR)


def test_arrows_point_where_the_best_action_leads(learned):
    q = np.zeros((6, 4))
    q[[0, 1, 4], [RIGHT, DOWN, RIGHT]] = 1.0
    axis = plt.figure().add_subplot()
    draw_arrows(axis, learned._replace(q=q))
    # Rows run downwards, so down is a positive step in y.
    assert arrows_on(axis) == {(0, 0): (1, 0), (1, 0): (0, 1), (1, 1): (1, 0)}


class TestTheWholePicture:
    """A picture of a map with a V that is wrong everywhere and a best action that differs between cells."""

    #: Cells 0, 1 and 4 count; V* there is 0.81, 0.9 and 1.
    value = np.asarray([0.5, 1.2, 9.0, 9.0, 0.7, 9.0], np.float32)
    ours = ((0.5, 1.2, np.nan), (np.nan, 0.7, np.nan))
    theirs = ((0.81, 0.9, np.nan), (np.nan, 1.0, np.nan))
    gap = ((-0.31, 0.3, np.nan), (np.nan, -0.3, np.nan))
    arrows: ClassVar = {(0, 0): (1, 0), (1, 0): (0, 1), (1, 1): (1, 0)}

    @pytest.fixture
    def drawn(self, learned):
        q = np.zeros((6, 4), np.float32)
        q[[0, 1, 4], [RIGHT, DOWN, RIGHT]] = 1.0
        return learned._replace(value=self.value, q=q)

    def test_each_panel_shows_its_own_numbers(self, drawn):
        of_map, *panels = figure_of_one(drawn).axes[:4]
        assert len(colour_of_cells(of_map)) == 4
        for axis, expected in zip(panels, (self.ours, self.theirs, self.gap), strict=True):
            np.testing.assert_allclose(shown_on(axis), expected, atol=1e-6)
        titles = [axis.get_title() for axis in panels]
        assert titles == ["learned V and greedy actions", "V*", "learned V − V*"]

    def test_arrows_are_on_the_learned_value_alone(self, drawn):
        axes = figure_of_one(drawn).axes[:4]
        assert [arrows_on(axis) for axis in axes] == [{}, self.arrows, {}, {}]

    def test_both_values_share_their_colours_and_no_difference_is_in_the_middle(self, drawn):
        _, ours, theirs, gap = (axis.images[0].get_clim() for axis in figure_of_one(drawn).axes[:4])
        assert ours == theirs == pytest.approx((0.5, 1.2))
        assert gap == pytest.approx((-0.31, 0.31))

    def test_a_sheet_has_pairs(self, drawn, learned):
        axes = figure_of_sheet([drawn, learned], columns=2).axes
        np.testing.assert_allclose(shown_on(axes[0]), self.ours, atol=1e-6)
        for axis in (axes[1], axes[3]):
            np.testing.assert_allclose(shown_on(axis), self.theirs, atol=1e-6)
            assert arrows_on(axis) == {}
        assert arrows_on(axes[0]) == self.arrows
        own = np.where(learned.states, learned.value, np.nan).reshape(2, 3)
        np.testing.assert_allclose(shown_on(axes[2]), own, atol=1e-6)


def test_learned_maps_carry_each_map_s_own_numbers(network):
    other = read_map("..G\n#.S")
    maps = jax.tree.map(lambda *leaves: np.stack(leaves), ONE, other)
    every = learned_maps(GAME, truths(GAME, maps, 0.9), maps, network, 50)
    observations = GAME.observe_all(other)
    np.testing.assert_allclose(every[1].value, jax.vmap(network.value)(observations), atol=1e-6)
    np.testing.assert_allclose(every[1].q, jax.vmap(network)(observations), atol=1e-6)
    assert [int(one.params.goal) for one in every] == [5, 2]
    assert [float(one.measures.optimal_return) for one in every] == pytest.approx([0.81, 1.0])


@pytest.mark.parametrize(("count", "expected"), [(3, [2, 0, 1]), (2, [2, 1]), (9, [2, 3, 0, 4, 1]), (1, [2])])
def test_a_sheet_has_the_worst_and_the_best(count, expected):
    chosen = spread_by_rank(np.asarray([0.5, 0.9, -0.1, 0.2, 0.7]), count)
    assert chosen.tolist() == expected


def test_the_caption_says_the_numbers(learned):
    said = caption(learned.measures._replace(rank_correlation=np.float32(0.5), success=np.float32(1.0)))
    assert said.startswith("rank correlation 0.500, ")
    assert ", success 1.00, " in said
    assert said.endswith("of 0.810")


def test_pictures_are_written(learned, tmp_path):
    draw_one(learned, tmp_path / "one.png")
    draw_sheet([learned] * 3, tmp_path / "sheet.png", columns=2)
    for name, shape in (("one.png", (510, 1950)), ("sheet.png", None)):
        pixels = plt.imread(tmp_path / name)
        assert pixels.std() > 0.05, "something was drawn"
        if shape:
            assert pixels.shape[:2] == shape


def test_a_value_that_is_everywhere_right_has_no_difference(learned, tmp_path):
    draw_one(learned._replace(value=learned.optimal_value), tmp_path / "one.png")
    assert (tmp_path / "one.png").stat().st_size > 10_000
