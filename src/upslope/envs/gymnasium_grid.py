"""Grid games as a Gymnasium environment, by tables of the rules of the compiled games. Needs no JAX."""

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from upslope.envs.grid_rules import observation, outcomes
from upslope.envs.map_text import FREE, GOAL, OBSTACLE, START, TRAP, read_board, write_map
from upslope.errors import UpslopeError

#: The default: a map of the paper's size.
MAP = """
S..#....
.#...#..
...#....
.#..#.#.
....#...
.##...#.
..#.#.#.
#.....#G
"""

_PIXELS = 40
_COLOURS = {
    START: (120, 180, 120),
    GOAL: (240, 190, 60),
    OBSTACLE: (70, 70, 70),
    TRAP: (200, 60, 60),
    FREE: (255, 255, 255),
}
_LINE, _AGENT = (221, 221, 221), (40, 90, 200)


class GymnasiumGrid(gym.Env):
    """One map on the host; see `upslope.envs.grid` for the game. `gymnasium.make` adds the time limit."""

    metadata: dict[str, Any] = {  # noqa: RUF012 (Gymnasium declares it so)
        "render_modes": ["rgb_array", "ansi"],
        "render_fps": 4,
    }

    def __init__(
        self,
        map: str | Sequence[str] = MAP,
        *,
        slip: float = 0.0,
        trap_penalty: float = 1.0,
        flat: bool = False,
        render_mode: str | None = None,
    ):
        """Makes the game of one map.

        Args:
            map: rows of S, G, # (obstacle), T (trap) and . (free), as one text or one string per row;
                `upslope.envs.map_text.write_map` writes a task of a family like this.
            slip: probability that a move goes to one of its two sides instead.
            trap_penalty: cost of entering a trap.
            flat: whether observations are one vector instead of channels ``[height, width, channels]``.
            render_mode: "rgb_array" for pictures, "ansi" for text.

        Raises:
            UpslopeError: the text is not a map, or the penalty or the probability is out of range.
        """
        board = read_board(map if isinstance(map, str) else "\n".join(map), trap_penalty=trap_penalty, slip=slip)
        cells, traps = range(board.obstacles.size), bool(board.traps.any())
        views = np.stack([observation(np, board, cell, traps=traps) for cell in cells])
        shape = (-1,) if flat else (*board.obstacles.shape, views.shape[-1])
        self._views = views.reshape(len(views), *shape)
        self._outcomes = outcomes(np, board, slippery=slip > 0)
        self._cell = int(board.start)
        self.params, self.render_mode = board, render_mode
        self.observation_space = gym.spaces.Box(0.0, 1.0, self._views.shape[1:], np.float32)
        self.action_space = gym.spaces.Discrete(self._outcomes.successors.shape[1])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begins in the start cell, or in that of ``options={"cell": row · width + column}``.

        Raises:
            UpslopeError: the agent can't act in this cell.
        """
        super().reset(seed=seed)
        self._cell = int((options or {}).get("cell", self.params.start))
        acting = self._outcomes.acting
        if not (0 <= self._cell < len(acting) and acting[self._cell]):
            raise UpslopeError(f"No episode begins in cell {self._cell}: give a free one of the {len(acting)} cells.")
        return self._views[self._cell].copy(), {}

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Up (0), down (1), left (2) or right (3)."""
        here = (self._cell, int(action))
        ways = self._outcomes.probabilities[here]
        way = 0 if len(ways) == 1 else int(np.searchsorted(np.cumsum(ways), self.np_random.random(), side="right"))
        there = (*here, min(way, len(ways) - 1))
        self._cell = int(self._outcomes.successors[there])
        reward, terminated = float(self._outcomes.rewards[there]), bool(self._outcomes.terminated[there])
        return self._views[self._cell].copy(), reward, terminated, False, {}

    def render(self) -> np.ndarray | str | None:
        """The map and the agent: ``[40 · height, 40 · width, 3]`` in 8 bits, or text with an @."""
        rows = write_map(self.params).splitlines()
        row, column = divmod(self._cell, len(rows[0]))
        if self.render_mode == "ansi":
            rows[row] = rows[row][:column] + "@" + rows[row][column + 1 :]
            return "\n".join(rows)
        if self.render_mode is None:
            return None
        from PIL import Image, ImageDraw  # installed with matplotlib; only pictures need it

        picture = Image.new("RGB", (_PIXELS * len(rows[0]), _PIXELS * len(rows)))
        draw = ImageDraw.Draw(picture)
        for y, marks in enumerate(rows):
            for x, mark in enumerate(marks):
                corners = [x * _PIXELS, y * _PIXELS, (x + 1) * _PIXELS - 1, (y + 1) * _PIXELS - 1]
                draw.rectangle(corners, fill=_COLOURS[mark], outline=_LINE)
        margin = _PIXELS // 4
        x, y = column * _PIXELS, row * _PIXELS
        draw.ellipse([x + margin, y + margin, x + _PIXELS - margin, y + _PIXELS - margin], fill=_AGENT)
        return np.asarray(picture)
