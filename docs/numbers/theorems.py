"""The tables of docs/theorems.md."""

from docs.numbers.shared import load

from upslope.experiments.theorems.tables import alternation_table, credit_table, invariance_tables


def invariance() -> str:
    """Thm. 2.1: four tables, one for each kind of maps."""
    return invariance_tables(load("theorems"))


def credit() -> str:
    """Thm. 3.1."""
    return credit_table(load("theorems"))


def alternation() -> str:
    """Thm. 3.2 on tables."""
    return alternation_table(load("theorems"))


def bounds() -> str:
    """The largest stable ratio of Eq. 9's step to Eq. 8's."""
    bounds = [f"{bound:.3f} at γ = {gamma}" for gamma, bound in load("theorems")["stable_ratio"].items()]
    return f"The smallest bound over all policies is {', '.join(bounds[:-1])} and {bounds[-1]}: not far above 1 − γ."


def network() -> str:
    """Thm. 3.2 on a network."""
    found = load("theorems")
    ratios = found["network"]["ratios"]
    equal, shorter = (f"{max(run[-1] for run in ratios[ratio]['value']):.1g}" for ratio in ("1.0", "0.1"))
    if any(run[-1] < 1 for runs in ratios.values() for run in runs["policy"]):
        raise ValueError("Some greedy action on the network's map is not optimal.")
    config = found["configuration"]
    return (
        f"After {config['updates']:,} pairs of steps, in the worst state of the worst of {config['seeds']} seeds, V is "
        f"within {equal} of V* with equal steps and within {shorter} with the ratio 0.1. The greedy action is optimal "
        "in every state."
    )
