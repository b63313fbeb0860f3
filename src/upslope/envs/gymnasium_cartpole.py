"""CartPole with a pole of any length as a Gymnasium environment; the equations are the compiled one's. No JAX."""

import math
from numbers import Real
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np

from upslope.envs.cartpole_physics import Pole, euler_equations
from upslope.errors import UpslopeError

_FAST = 1000.0
_NUMBERS = (
    "length", "half_length", "pole_mass", "total_mass", "gravity", "force", "time_step", "angle_limit", "track_limit",
)  # fmt: skip
_WIDTH, _HEIGHT = 600, 400
_SKY, _LINE, _CART, _POLE, _AXLE = (255, 255, 255), (0, 0, 0), (40, 44, 52), (202, 152, 101), (129, 132, 203)


class GymnasiumCartPole(gym.Env):
    """The cart and the pole, on the host, in double precision; observations are float32.

    The reward is 1 for every step. The episode terminates when the pole has fallen or the cart has left the track;
    `gymnasium.make` adds the time limit. ``reset(options={"state": four numbers})`` starts in that state.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (Gymnasium declares it so)
        "render_modes": ["rgb_array"],
        "render_fps": 50,
    }

    def __init__(
        self,
        length: float = 1.0,
        *,
        continuous: bool = False,
        angle_limit_degrees: float = 15.0,
        track_limit: float = 2.4,
        render_mode: str | None = None,
    ):
        """Makes one CartPole.

        Args:
            length: the full length of the pole, in metres. Gymnasium's default pole is 1.0 by this measure.
            continuous: one force in [−1, 1] (times 10 N) instead of two pushes.
            angle_limit_degrees: degrees from upright beyond which the pole has fallen.
            track_limit: metres from the centre beyond which the cart has left the track.
            render_mode: "rgb_array" for pictures.

        Raises:
            UpslopeError: a length or a limit that is not positive and finite.
        """
        for name, value in (
            ("length", length),
            ("angle_limit_degrees", angle_limit_degrees),
            ("track_limit", track_limit),
        ):
            if not (isinstance(value, Real) and value > 0 and math.isfinite(value)):
                raise UpslopeError(f"{name} is {value!r}, but it must be positive: give a number of metres or degrees.")
        pole = Pole(float(length), angle_limit=math.radians(angle_limit_degrees), track_limit=float(track_limit))
        # Derived once, as plain numbers: computing them in every step would cost as much as the physics.
        self.params = SimpleNamespace(**{name: float(getattr(pole, name)) for name in _NUMBERS})
        self.continuous = continuous
        self.render_mode = render_mode
        # Twice the limits, as in Gymnasium, because the observation that ends an episode lies beyond them. No pole of
        # more than a centimetre gets as fast as _FAST.
        high = np.array([2 * track_limit, _FAST, 2 * math.radians(angle_limit_degrees), _FAST], np.float32)
        self.observation_space = gym.spaces.Box(-high, high, dtype=np.float32)
        self.action_space = gym.spaces.Box(-1.0, 1.0, (1,), np.float32) if continuous else gym.spaces.Discrete(2)
        self._physics: list[float] = []

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Every coordinate is drawn from U[−0.05, 0.05], unless the options give a state.

        Raises:
            UpslopeError: a state that is not four finite numbers.
        """
        super().reset(seed=seed)
        state = (options or {}).get("state", self.np_random.uniform(-0.05, 0.05, size=4))
        if np.shape(state) != (4,) or not np.isfinite(state).all():
            raise UpslopeError(f"The state {state!r} is not four numbers: position, velocity, angle, angular velocity.")
        self._physics = np.asarray(state, np.float64).tolist()
        return self._obs(), {}

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """One Euler step of 0.02 s.

        Raises:
            UpslopeError: not an action of the action space.
        """
        angle = self._physics[2]
        self._physics = euler_equations(
            tuple(self._physics), self._force(action), math.cos(angle), math.sin(angle), self.params
        )
        position, _, angle, _ = self._physics
        terminated = abs(position) > self.params.track_limit or abs(angle) > self.params.angle_limit
        return self._obs(), 1.0, terminated, False, {}

    def render(self) -> np.ndarray | None:
        """The cart, the pole and the track, ``[400, 600, 3]`` in 8 bits; None without ``render_mode``."""
        if self.render_mode is None:
            return None
        from PIL import Image, ImageDraw  # installed with matplotlib; only pictures need it

        picture = Image.new("RGB", (_WIDTH, _HEIGHT), _SKY)
        draw = ImageDraw.Draw(picture)
        scale = _WIDTH / (2.2 * self.params.track_limit)
        x, y = _WIDTH / 2 + scale * self._physics[0], 0.75 * _HEIGHT
        # A pole of five metres must fit into the picture.
        reach = min(scale * self.params.length, 0.7 * _HEIGHT)
        tip = (x + reach * math.sin(self._physics[2]), y - reach * math.cos(self._physics[2]))
        draw.line([(0, y + 15), (_WIDTH, y + 15)], fill=_LINE)
        draw.rectangle([x - 25, y - 15, x + 25, y + 15], fill=_CART)
        draw.line([(x, y), tip], fill=_POLE, width=8)
        draw.ellipse([x - 5, y - 5, x + 5, y + 5], fill=_AXLE)
        return np.asarray(picture)

    def _force(self, action: Any) -> float:
        full = self.params.force
        if self.continuous:
            share = float(np.reshape(action, ()))
            if not math.isnan(share):
                return full * min(max(share, -1.0), 1.0)
        elif action == 1:
            return full
        elif action == 0:
            return -full
        raise UpslopeError(f"{action!r} is not an action of this environment: give one of {self.action_space}.")

    def _obs(self) -> np.ndarray:
        return np.array(self._physics, np.float32)
