"""Set-up that must come before any import of upslope: the CPU, two virtual devices, runtime shape checks."""

import os

os.environ.setdefault("JAX_PLATFORMS", "cpu")

import jax
import pytest
from hypothesis import settings
from jaxtyping import install_import_hook

# Two devices on any machine, so that spreading and padding are always tried.
jax.config.update("jax_num_cpu_devices", 2)
install_import_hook("upslope", "beartype.beartype")

settings.register_profile("upslope", deadline=None, derandomize=True, max_examples=40)
settings.load_profile("upslope")


@pytest.fixture(scope="session")
def prior():
    """A prior for CartPoles, untrained but of the usual size; γ is 0.98."""
    from upslope.networks import DuelingQ
    from upslope.prior import Prior, trained_on
    from upslope.tasks import cartpoles

    network = DuelingQ(jax.random.key(7), 4, 2, (32, 32), cartpoles().observation_scale, "tanh")
    return Prior(network, trained_on(cartpoles(), network, 7, {}))
