"""Environments of our own, stateless and compiled, with the signature of gymnax ≥ 1.0."""

from upslope.envs.cartpole import CartPole, CartPoleParams, CartPoleState
from upslope.envs.grid import GridGame, GridParams, GridState

__all__ = ["CartPole", "CartPoleParams", "CartPoleState", "GridGame", "GridParams", "GridState"]
