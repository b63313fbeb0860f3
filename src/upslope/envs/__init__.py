"""Environments of our own, stateless and compiled, with the signature of gymnax ≥ 1.0."""

from upslope.envs.cartpole import CartPole, CartPoleParams, CartPoleState

__all__ = ["CartPole", "CartPoleParams", "CartPoleState"]
