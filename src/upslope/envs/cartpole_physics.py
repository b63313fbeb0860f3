"""The equations of the cart and the pole, for plain numbers and arrays. Needs no JAX.

Simulator processes that balance a pole on the host therefore load none.
"""

import math
from dataclasses import dataclass
from typing import Any

FIFTEEN_DEGREES = 15 * math.pi / 180


class PoleGeometry:
    """What follows from the pole's length; `upslope.envs.cartpole.CartPoleParams` has the free parameters."""

    length: Any
    cart_mass: Any
    pole_density: Any

    @property
    def half_length(self) -> Any:
        """From the pivot to the centre of mass; what Gymnasium calls ``length``."""
        return self.length / 2

    @property
    def pole_mass(self) -> Any:
        return self.pole_density * self.length

    @property
    def total_mass(self) -> Any:
        return self.cart_mass + self.pole_mass


@dataclass(frozen=True)
class Pole(PoleGeometry):
    """The free parameters of one CartPole as plain numbers; see `upslope.envs.cartpole.CartPoleParams`."""

    length: float = 1.0
    gravity: float = 9.8
    cart_mass: float = 1.0
    pole_density: float = 0.1
    force: float = 10.0
    time_step: float = 0.02
    angle_limit: float = FIFTEEN_DEGREES
    track_limit: float = 2.4


def euler_equations(physics: tuple, force: Any, cosine: Any, sine: Any, params: Any) -> list:
    """One Euler step of the four coordinates: arithmetic only, for plain floats and arrays alike."""
    position, velocity, angle, angular_velocity = physics
    pole_moment = params.pole_mass * params.half_length
    thrust = (force + pole_moment * angular_velocity**2 * sine) / params.total_mass
    inertia = params.half_length * (4.0 / 3.0 - params.pole_mass * cosine**2 / params.total_mass)
    angular_acceleration = (params.gravity * sine - cosine * thrust) / inertia
    acceleration = thrust - pole_moment * angular_acceleration * cosine / params.total_mass
    return [
        position + params.time_step * velocity,
        velocity + params.time_step * acceleration,
        angle + params.time_step * angular_velocity,
        angular_velocity + params.time_step * angular_acceleration,
    ]
