"""Families on the host, by values: rewards and ends by hand, walls that block, rooms that are the task's."""

import gymnasium as gym
import numpy as np
import pytest

from upslope.errors import UpslopeError
from upslope.families import crossings, extras, frozen_lakes, point_mazes, reach
from upslope.families.frozen_lakes import Lake, ObservedLake

RNG = np.random.default_rng


class TestReach:
    def test_goals_are_on_both_sides(self):
        tasks = [reach.sample(RNG(seed)) for seed in range(200)]
        goals, masses = np.array(tasks).T
        assert 0.4 < (goals > 0).mean() < 0.6
        assert (np.abs(goals).min() >= 0.5, np.abs(goals).max() <= 1.5) == (True, True)
        assert (masses.min() >= 0.5, masses.max() <= 2.0) == (True, True)

    def test_a_push_moves_it_by_the_mass(self):
        env = reach.Reach(reach.ReachTask(1.0, 2.0))
        (place, speed, goal), _ = env.reset(seed=0)
        obs, reward, terminated, truncated, _ = env.step(2)
        assert (speed, goal, reward, terminated, truncated) == (0.0, 1.0, 0.0, False, False)
        assert obs[1] == pytest.approx(0.98 * 0.05 / 2.0)
        assert obs[0] == pytest.approx(place + 0.1 * obs[1])

    def test_it_pays_once_at_the_goal(self):
        env = reach.Reach(reach.ReachTask(0.5, 0.5))
        env.reset(seed=0)
        rewards, terminated = [], False
        while not terminated:  # push, and brake half way
            action = 2 if env._place < 0.25 else 0 if env._speed > 0.05 else 1
            _, reward, terminated, _, _ = env.step(action)
            rewards.append(reward)
        assert rewards[-1] == 1.0
        assert sum(rewards) == 1.0

    def test_leaving_ends_it_without_a_reward(self):
        env = reach.Reach(reach.ReachTask(1.0, 0.5))
        env.reset(seed=0)
        steps = [env.step(0)[1:3] for _ in range(100)]
        assert steps[-1][1]
        assert all(reward == 0 for reward, _ in steps)


class TestFrozenLakes:
    LAKE = Lake(("SF", "HG"), False)

    def test_observations_are_place_holes_and_ice(self):
        env = ObservedLake(self.LAKE)
        obs, _ = env.reset(seed=0)
        np.testing.assert_array_equal(obs, [1, 0, 0, 0, 0, 0, 1, 0, 0])
        obs, reward, terminated, _, _ = env.step(2)  # to the right
        np.testing.assert_array_equal(obs[:4], [0, 1, 0, 0])
        assert (reward, terminated) == (0, False)
        obs, reward, terminated, _, _ = env.step(1)  # down, to the goal
        assert (reward, terminated) == (1, True)
        assert ObservedLake(Lake(self.LAKE.rows, True)).reset(seed=0)[0][-1] == 1

    def test_lakes_differ_and_some_are_slippery(self):
        family = frozen_lakes.frozen_lakes()
        lakes = [family.sample_task(RNG(seed)) for seed in range(30)]
        assert len({lake.rows for lake in lakes}) > 20
        assert 5 < sum(lake.slippery for lake in lakes) < 25


class TestPointMazes:
    TASKS = point_mazes.MazeTasks(5, 0.25)

    def test_free_cells_hang_together_inside_a_frame(self):
        for seed in range(20):
            walls = self.TASKS(RNG(seed))
            assert all(edge.all() for edge in (walls[0], walls[-1], walls[:, 0], walls[:, -1]))
            _, regions = point_mazes.label(walls == 0)
            assert regions == 1
            assert (walls == 0).sum() >= 9

    def test_exchanged_walls_are_those_of_a_maze_that_was_built_with_them(self):
        """The same starts, goals and steps as Gymnasium-Robotics' own maze of this map."""
        maze = point_mazes.ObservedMaze(5, 100)
        for seed in (0, 1):
            walls = self.TASKS(RNG(seed))
            maze.set_walls(walls)
            built = gym.make("PointMaze_UMaze-v3", maze_map=walls.tolist(), continuing_task=False)
            ours, _ = maze.reset(seed=7)
            theirs, _ = built.reset(seed=7)
            np.testing.assert_array_equal(ours[6:], walls[1:-1, 1:-1].ravel())
            for action in RNG(3).uniform(-1, 1, (60, 2)).astype(np.float32).repeat(5, axis=0)[:90]:
                np.testing.assert_allclose(ours[:4], theirs["observation"], atol=1e-6)
                np.testing.assert_allclose(ours[4:6], theirs["desired_goal"], atol=1e-6)
                ours, reward, terminated, *_ = maze.step(action)
                theirs, their_reward, ended, *_ = built.step(action)
                assert (reward, terminated) == (their_reward, ended)
                if terminated:
                    break


class TestCrossings:
    def test_a_task_is_one_room(self):
        family = crossings.crossings()
        env = family.rollouts._slot()._factory.make_env(5)
        first, _ = env.reset(seed=1)
        again, _ = env.reset(seed=2)
        np.testing.assert_array_equal(first, again)
        family.rollouts._slot()._factory.set_task(env, 6)
        other, _ = env.reset(seed=1)
        assert (other != first).any()
        assert first.shape == family.observation_shape == (9, 9, 3)

    def test_three_actions(self):
        assert crossings.crossings().actions.count == 3


def test_a_missing_simulator_is_named_with_the_command_that_installs_it(monkeypatch):
    def refuse(name, *others, **more):
        raise ImportError(name)

    monkeypatch.setattr(extras.importlib, "import_module", refuse)
    with pytest.raises(UpslopeError, match=r"needs the package minigrid.*pip install 'upslope\[families\]'"):
        extras.minigrid()
