"""The versions and the hardware behind a result, for results.json."""

import os
import platform
from importlib.metadata import version

import jax

_PACKAGES = ("upslope", "jax", "jaxlib", "equinox", "optax", "numpy", "scipy", "gymnasium")


def versions() -> dict[str, str]:
    """Versions of Python and of every package that can change a result."""
    return {"python": platform.python_version()} | {name: version(name) for name in _PACKAGES}


def hardware() -> dict[str, object]:
    """The machine's properties, without its name."""
    return {
        "system": platform.system(),
        "architecture": platform.machine(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "devices": [f"{device.platform}:{device.device_kind}" for device in jax.local_devices()],
    }


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as lines:
            return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor()
