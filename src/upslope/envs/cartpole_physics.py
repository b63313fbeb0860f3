"""The cart and the pole as arithmetic, on plain numbers or on arrays: nothing here needs JAX.

So a simulator process that balances a pole on the host need not load it.
"""

import math
from dataclasses import dataclass
from typing import Any

FIFTEEN_DEGREES = 15 * math.pi / 180


class Lengthened:
    """What follows from a pole's length; see `upslope.envs.cartpole.CartPoleParams` for what is chosen."""

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
class Pole(Lengthened):
    """The chosen numbers of one CartPole, plain; see `upslope.envs.cartpole.CartPoleParams` for what they are."""

    length: float = 1.0
    gravity: float = 9.8
    cart_mass: float = 1.0
    pole_density: float = 0.1
    force: float = 10.0
    time_step: float = 0.02
    angle_limit: float = FIFTEEN_DEGREES
    track_limit: float = 2.4


def euler_equations(physics: tuple, force: Any, cosine: Any, sine: Any, params: Any) -> list:
    """The equations of `euler_step` on four numbers: arithmetic only, so that plain floats do as well as arrays."""
    position, velocity, angle, angular_velocity = physics
    pole_moment = params.pole_mass * params.half_length
    pushed = (force + pole_moment * angular_velocity**2 * sine) / params.total_mass
    inertia = params.half_length * (4.0 / 3.0 - params.pole_mass * cosine**2 / params.total_mass)
    angular_acceleration = (params.gravity * sine - cosine * pushed) / inertia
    acceleration = pushed - pole_moment * angular_acceleration * cosine / params.total_mass
    return [
        position + params.time_step * velocity,
        velocity + params.time_step * acceleration,
        angle + params.time_step * angular_velocity,
        angular_velocity + params.time_step * angular_acceleration,
    ]
