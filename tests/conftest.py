"""Set-up that must come before any import of upslope: the CPU, two virtual devices, runtime shape checks."""

import os
import shutil
import tempfile

os.environ.setdefault("JAX_PLATFORMS", "cpu")
if "PYTEST_XDIST_WORKER" not in os.environ:  # workers inherit both
    # Tests mostly compile what they run once; upslope's own programs say themselves how they are compiled.
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_backend_optimization_level=1".strip()
    # Many tests compile the same programs, and none may find those of another run.
    os.environ["UPSLOPE_CACHE"] = tempfile.mkdtemp(prefix="upslope-tests-")

import jax
import pytest
from hypothesis import settings
from jaxtyping import install_import_hook

# Two devices on any machine, so that spreading and padding are always tried.
jax.config.update("jax_num_cpu_devices", 2)
jax.config.update("jax_compilation_cache_dir", os.environ["UPSLOPE_CACHE"])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
install_import_hook("upslope", "beartype.beartype")

settings.register_profile("upslope", deadline=None, derandomize=True, max_examples=40)
settings.load_profile("upslope")


def pytest_unconfigure(config):
    """Only the first process, which ends last, removes the folder."""
    if not hasattr(config, "workerinput"):
        shutil.rmtree(os.environ["UPSLOPE_CACHE"], ignore_errors=True)


@pytest.fixture(scope="session")
def prior():
    """A prior for CartPoles, untrained but of the usual size; γ is 0.98."""
    from upslope.networks.dueling import DuelingQ
    from upslope.priors.prior import Prior, trained_on
    from upslope.tasks import cartpoles

    network = DuelingQ(jax.random.key(7), 4, 2, (32, 32), cartpoles().observation_scale, "tanh")
    return Prior(network, trained_on(cartpoles(), network, 7, {}))
