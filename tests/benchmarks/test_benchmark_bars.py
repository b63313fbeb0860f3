"""The benchmarks' bars, and the numbers that they are made of, from rows that are known."""

import jax
import jax.numpy as jnp
import pytest
from benchmarks.compile_costs import EVENTS, WAITED, Forgetful, covered
from benchmarks.learning_curves import standard_errors_apart
from benchmarks.meta_gradient import EACH_CORE, SHARE, SHARED

from benchmarks import environments, meta_gradient, scaling


def test_seconds_within_spans_count_once():
    assert covered([]) == 0
    assert covered([(0, 4), (1, 2), (3, 5), (7, 8)]) == 6


@pytest.mark.slow
def test_a_job_that_forgets_its_programs_compiles_each_time():
    settings = jax.config.jax_compilation_cache_dir
    program = jax.jit(lambda x: jnp.sin(x) + 1)
    job = Forgetful(lambda: program(jnp.ones(3)).block_until_ready(), empty=True)
    try:
        for _ in range(3):
            job()
    finally:
        jax.config.update("jax_compilation_cache_dir", settings)
    columns = job.columns()
    assert set(columns) == {*EVENTS.values(), WAITED}
    assert all(seconds > 0 for seconds in columns.values())
    assert len(job.found) == 3


def test_a_learner_on_each_core_is_judged_by_its_best_form():
    rows = {"a product": {"median": 1.0}}
    for name, median, share in (
        ("upslope, winograd", 0.2, 0.5),
        ("PyTorch, torch.func", 0.1, 0.6),
        ("PyTorch, loop over tasks", 0.3, 0.2),
        (f"upslope, winograd, {EACH_CORE}", 0.4, 0.5),
        (f"upslope, rows, {EACH_CORE}", 0.2, 0.7),
    ):
        rows[f"10 tasks, stopped: {name}"] = {"median": median, SHARE: share}
    share, against, each, each_against = meta_gradient.bars(rows)
    assert (share.measured, against.measured) == (0.5, 0.5)
    assert "slower" in against.bound
    assert "2.5 × that is 1.5 times" in against.bound
    assert "rows" in each.what
    assert (each.measured, each.verdict) == (0.7, "met")
    assert each_against.measured == jax.device_count() * 0.1 / 0.2
    rows[f"10 tasks, stopped: upslope, winograd, {SHARED}"] = {"median": 0.05, SHARE: 0.8}
    share, against, *_ = meta_gradient.bars(rows)
    assert (share.measured, against.measured) == (0.8, 2.0), "a learner alone has its tasks shared"


def test_exponents_of_medians_and_of_the_fastest():
    rows = {f"tasks: {n:,}": {"median": n**1.05, "fastest": float(n)} for n in (10, 100, 1000)}
    fits = {"tasks": scaling.fit(rows, "tasks", [10, 100, 1000])}
    assert fits["tasks"]["exponent"] == pytest.approx(1.05)
    assert fits["tasks"]["exponent of the fastest"] == pytest.approx(1)
    (bar,) = scaling.bars(fits)
    assert bar.verdict == "met"
    assert bar.close


def test_the_budget_of_a_step():
    options = environments.Options(widths=(20_000,))
    names = ("CartPole, upslope", environments.ON_ALL_CORES, "CartPole, Gymnasium Sync")
    rows = {f"{name}, 20,000, alone": {"steps/s": rate} for name, rate in zip(names, (1e7, 2e7, 1e5), strict=True)}
    rows[f"{environments.RESETS}, 20,000"] = {"steps/s": 2.5e7}
    bar = environments.bars(rows, options)[-1]
    assert bar.measured == 200
    assert "takes 10,000 ns a step, so the bar leaves 20.0; upslope takes 100 on one device" in bar.bound
    assert "and 50.0 on a device for each core. About 40.0 are" in bar.bound


def test_means_are_compared_in_standard_errors():
    assert standard_errors_apart([1.0], [2.0]) is None
    assert standard_errors_apart([0.0, 2.0] * 8, [1.0, 3.0] * 8) == pytest.approx(2.74, abs=0.01)
