"""Pictures of learned values on maps (Figs. 2 and 4): learned V, V*, their difference, and the greedy policy."""

from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import matplotlib.pyplot as plt
import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Rectangle

from upslope.envs.grid import GridGame, GridParams
from upslope.planning.measures import Measures, Truth, measure_all, tables

#: The paper's colours: the start is red, the goal green.
START_COLOUR, GOAL_COLOUR, WALL_COLOUR, TRAP_COLOUR = "#d73027", "#1a9850", "#404040", "#762a83"
VALUES, DIFFERENCES = "viridis", "RdBu"

#: Column and row steps of up, down, left and right, on an axis whose rows run downwards.
_ARROWS = np.array([[0, -1], [0, 1], [-1, 0], [1, 0]])


class LearnedMap(NamedTuple):
    """One map with learned and exact values.

    Attributes:
        params: the map.
        value: learned V ``[cells]``.
        q: learned Q, or other scores of the actions ``[cells, actions]``; the largest is the greedy action.
        optimal_value: V* ``[cells]``.
        states: cells that count ``[cells]``; the others are left blank.
        measures: the measures of this map.
    """

    params: GridParams
    value: Float[np.ndarray, "cells"]
    q: Float[np.ndarray, "cells actions"]
    optimal_value: Float[np.ndarray, "cells"]
    states: np.ndarray
    measures: Measures


def learned_maps(env: GridGame, exact: Truth, maps: GridParams, network: Any, steps: int) -> list[LearnedMap]:
    """A network's values on each of ``n`` stacked maps ``[n, ...]``, with the exact ones."""
    value, q = jax.device_get(_tables_of_all(env, maps, network))
    measures = jax.device_get(measure_all(env, exact, maps, network, steps))
    maps, exact = jax.device_get((maps, exact))

    def pick(tree: Any, index: int) -> Any:
        return jax.tree.map(lambda leaf: leaf[index], tree)

    return [
        LearnedMap(
            pick(maps, index),
            value[index],
            q[index],
            np.asarray(exact.solution.value[index]),
            np.asarray(exact.states[index]),
            pick(measures, index),
        )
        for index in range(len(value))
    ]


@eqx.filter_jit
def _tables_of_all(env: GridGame, maps: GridParams, network: Any) -> Any:
    return jax.vmap(lambda one: tables(env, one, network))(maps)


def draw_one(learned: LearnedMap, path: Path, *, title: str = "") -> None:
    """Writes a picture of one map, made by `figure_of_one`, and the same as a PDF."""
    with plt.rc_context({"font.size": 9}):
        figure = figure_of_one(learned, title=title)
        figure.savefig(path, dpi=150)
        figure.savefig(path.with_suffix(".pdf"))
        plt.close(figure)


def figure_of_one(learned: LearnedMap, *, title: str = "") -> Figure:
    """Four panels: the map; learned V with arrows of the greedy policy; V*; learned V − V*."""
    figure, axes = plt.subplots(1, 4, figsize=(13, 3.4), layout="constrained")
    draw_map(axes[0], learned.params)
    axes[0].set_title(title or "map (start red, goal green)")
    shared = _range(learned)
    ours = draw_values(axes[1], learned, learned.value, limits=shared)
    draw_arrows(axes[1], learned)
    axes[1].set_title("learned V and greedy actions")
    theirs = draw_values(axes[2], learned, learned.optimal_value, limits=shared)
    axes[2].set_title("V*")
    gap = learned.value - learned.optimal_value
    size = max(float(np.abs(gap[learned.states]).max()), 1e-6)
    difference = draw_values(axes[3], learned, gap, limits=(-size, size), colours=DIFFERENCES)
    axes[3].set_title("learned V − V*")
    for image, axis in ((ours, axes[1]), (theirs, axes[2]), (difference, axes[3])):
        figure.colorbar(image, ax=axis, shrink=0.85)
    figure.suptitle(caption(learned.measures), fontsize=9)
    return figure


def draw_sheet(maps: list[LearnedMap], path: Path, *, columns: int = 6, title: str = "") -> None:
    """Writes a sheet of maps, made by `figure_of_sheet`, and the same as a PDF."""
    with plt.rc_context({"font.size": 7}):
        figure = figure_of_sheet(maps, columns=columns, title=title)
        figure.savefig(path, dpi=130)
        figure.savefig(path.with_suffix(".pdf"))
        plt.close(figure)


def figure_of_sheet(maps: list[LearnedMap], *, columns: int = 6, title: str = "") -> Figure:
    """Pairs of panels in the given order (see `spread_by_rank`): learned V with arrows, and V*."""
    rows = -(-len(maps) // columns)
    figure, axes = plt.subplots(
        rows, 2 * columns, figsize=(2.5 * columns, 1.62 * rows + 0.3), squeeze=False, layout="constrained"
    )
    for axis in axes.ravel():
        axis.axis("off")
    for index, learned in enumerate(maps):
        row, column = divmod(index, columns)
        left, right = axes[row, 2 * column], axes[row, 2 * column + 1]
        shared = _range(learned)
        draw_values(left, learned, learned.value, limits=shared)
        draw_arrows(left, learned)
        draw_values(right, learned, learned.optimal_value, limits=shared)
        solved = "solved" if learned.measures.success > 0.5 else "not solved"
        left.set_title(f"{float(learned.measures.rank_correlation):.2f}, {solved}", loc="left")
        right.set_title("V*")
    figure.suptitle(title or "learned V with greedy actions, and V*; rank correlation, from worst to best")
    return figure


def spread_by_rank(correlations: Float[np.ndarray, "maps"], count: int) -> Int[np.ndarray, "count"]:
    """Indices of maps for a sheet: evenly spaced from the worst rank correlation to the best, both included."""
    order = np.argsort(correlations, kind="stable")
    return order[np.unique(np.linspace(0, len(order) - 1, min(count, len(order))).round().astype(int))]


def caption(measures: Measures) -> str:
    """One line of numbers about a map."""
    return (
        f"rank correlation {float(measures.rank_correlation):.3f}, "
        f"mean squared error {float(measures.squared_error):.4f}, "
        f"action-optimality {float(measures.action_optimality):.2f}, "
        f"success {float(measures.success):.2f}, "
        f"return {float(measures.discounted_return):.3f} of {float(measures.optimal_return):.3f}"
    )


def draw_map(axis: Axes, params: GridParams) -> None:
    """Start, goal, obstacles and traps."""
    height, width = params.obstacles.shape
    axis.imshow(np.ones((height, width, 3)))
    for column in range(1, width):
        axis.axvline(column - 0.5, color="#dddddd", linewidth=0.6)
    for row in range(1, height):
        axis.axhline(row - 0.5, color="#dddddd", linewidth=0.6)
    _fill(axis, np.flatnonzero(params.obstacles), WALL_COLOUR, width)
    _fill(axis, np.flatnonzero(params.traps), TRAP_COLOUR, width)
    _fill(axis, [int(params.start)], START_COLOUR, width)
    _fill(axis, [int(params.goal)], GOAL_COLOUR, width)
    axis.set_xticks([])
    axis.set_yticks([])


def draw_values(
    axis: Axes,
    learned: LearnedMap,
    values: Float[np.ndarray, "cells"],
    *,
    limits: tuple[float, float],
    colours: str | LinearSegmentedColormap = VALUES,
) -> AxesImage:
    """A heat map of numbers in the cells that count, over the map's start, goal, obstacles and traps."""
    params = learned.params
    height, width = params.obstacles.shape
    grid = np.where(learned.states, values, np.nan).reshape(height, width)
    image = axis.imshow(grid, cmap=colours, vmin=limits[0], vmax=limits[1])
    _fill(axis, np.flatnonzero(params.obstacles), WALL_COLOUR, width)
    _fill(axis, np.flatnonzero(params.traps), TRAP_COLOUR, width)
    _fill(axis, [int(params.goal)], GOAL_COLOUR, width)
    row, column = divmod(int(params.start), width)
    axis.add_patch(
        Rectangle((column - 0.46, row - 0.46), 0.92, 0.92, fill=False, edgecolor=START_COLOUR, linewidth=1.4)
    )
    axis.set_xticks([])
    axis.set_yticks([])
    return image


def draw_arrows(axis: Axes, learned: LearnedMap) -> None:
    """The greedy action of every cell that counts."""
    width = learned.params.obstacles.shape[1]
    cells = np.flatnonzero(learned.states)
    rows, columns = np.divmod(cells, width)
    steps = _ARROWS[np.argmax(learned.q[cells], axis=-1)]
    axis.quiver(
        columns, rows, steps[:, 0], steps[:, 1], color="white", edgecolor="black", linewidth=0.4,
        pivot="mid", angles="xy", scale_units="xy", scale=1.6, width=0.014, headwidth=4, headlength=4.5,
    )  # fmt: skip


def _fill(axis: Axes, cells: np.ndarray | list[int], colour: str, width: int) -> None:
    for cell in cells:
        row, column = divmod(int(cell), width)
        axis.add_patch(Rectangle((column - 0.5, row - 0.5), 1, 1, facecolor=colour, linewidth=0))


def _range(learned: LearnedMap) -> tuple[float, float]:
    both = np.stack([learned.value, learned.optimal_value])[:, learned.states]
    return float(both.min()), float(both.max())
