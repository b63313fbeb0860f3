"""Mazes with random walls, in which a ball is pushed to a goal: Gymnasium-Robotics' PointMaze."""

from typing import Any

import gymnasium as gym
import numpy as np
from jaxtyping import Int
from scipy.ndimage import label

from upslope.families.extras import gymnasium_robotics
from upslope.tasks.gymnasium_tasks import GymnasiumTasks

Walls = Int[np.ndarray, "rows columns"]


class MazeTasks:
    """Draws mazes: walls inside a closed frame, all free cells connected, at least a third of the inner ones free.

    Attributes:
        cells: inner cells in each direction.
        walls: the probability of a wall in each of them.
    """

    def __init__(self, cells: int, walls: float):
        self.cells, self.walls = cells, walls

    def __call__(self, rng: np.random.Generator) -> Walls:
        while True:
            maze = np.ones((self.cells + 2, self.cells + 2), int)
            maze[1:-1, 1:-1] = rng.random((self.cells, self.cells)) < self.walls
            _, regions = label(maze == 0)
            if regions == 1 and 3 * (maze == 0).sum() >= self.cells**2:
                return maze


class ObservedMaze(gym.ObservationWrapper):
    """Position and velocity, goal and inner walls in one vector, in a maze whose walls can be exchanged.

    MuJoCo's model has a block in every cell; those of free cells collide with nothing. Compiling a model takes a
    hundred times as long.
    """

    def __init__(self, cells: int, max_steps: int):
        blocks = np.ones((cells + 2, cells + 2), int).tolist()
        gym.register_envs(gymnasium_robotics())
        super().__init__(
            gym.make("PointMaze_UMaze-v3", maze_map=blocks, continuing_task=False, max_episode_steps=max_steps)
        )
        self.observation_space = gym.spaces.Box(-np.inf, np.inf, (4 + 2 + cells**2,), np.float32)
        self._seen = np.zeros(cells**2, np.float32)

    def set_walls(self, walls: Walls) -> None:
        """Exchanges the walls; the next reset draws a start and a goal among the free cells."""
        base: Any = self.env.unwrapped
        model, maze = base.point_env.model, base.maze
        for row, column in np.ndindex(walls.shape):
            block = model.geom(f"block_{row}_{column}")
            block.contype[:] = block.conaffinity[:] = walls[row, column]
        free = [maze.cell_rowcol_to_xy(cell) for cell in np.argwhere(walls == 0)]
        for locations in (maze.unique_goal_locations, maze.unique_reset_locations):
            locations[:] = free
        self._seen = walls[1:-1, 1:-1].astype(np.float32).ravel()

    def observation(self, observation: dict[str, np.ndarray]) -> np.ndarray:
        return np.concatenate([observation["observation"], observation["desired_goal"], self._seen]).astype(np.float32)


def point_mazes(
    cells: int = 5,
    walls: float = 0.25,
    gamma: float = 0.98,
    bins: int | None = 3,
    max_steps: int = 200,
    mode: str = "sync",
) -> GymnasiumTasks:
    """Reward 1 at the goal, which ends the episode.

    Args:
        cells: inner cells in each direction.
        walls: the probability of a wall in each of them.
        gamma: γ.
        bins: forces in each direction, as one grid of discrete actions; None for continuous ones.
        max_steps: truncation.
        mode: where environments run, see `GymnasiumTasks`.
    """

    def make_env(task: Walls) -> gym.Env:
        maze = ObservedMaze(cells, max_steps)
        maze.set_walls(task)
        return maze if bins is None else gym.wrappers.DiscretizeAction(maze, bins, multidiscrete=False)

    def set_task(env: gym.Env, task: Walls) -> None:
        env.get_wrapper_attr("set_walls")(task)

    return GymnasiumTasks(
        MazeTasks(cells, walls),
        make_env,
        gamma,
        name=f"point-maze-{cells}",
        max_steps=max_steps,
        set_task=set_task,
        mode=mode,
    )
