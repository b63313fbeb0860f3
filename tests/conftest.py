"""Set-up that must come before any import of upslope: the CPU, two virtual devices, runtime shape checks."""

import os

os.environ.setdefault("JAX_PLATFORMS", "cpu")

import jax
from hypothesis import settings
from jaxtyping import install_import_hook

# Two devices on any machine, so that spreading and padding are always tried.
jax.config.update("jax_num_cpu_devices", 2)
install_import_hook("upslope", "beartype.beartype")

settings.register_profile("upslope", deadline=None, derandomize=True, max_examples=40)
settings.load_profile("upslope")
