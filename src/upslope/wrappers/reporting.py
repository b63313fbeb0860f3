"""What the wrappers report in ``info``: the raw reward, F and Φ. Shapings around each other add up."""

from typing import Any

import numpy as np
from jaxtyping import Float


def report(info: dict[str, Any], reward: float, added: float, potential: float) -> dict[str, Any]:
    """``info`` of one environment, with the raw reward, F and Φ as it counted."""
    if "shaping_reward" in info:  # from a shaping inside this one
        reward = info.get("raw_reward", reward)
        added += info["shaping_reward"]
        potential += info["potential"]
    return {**info, "raw_reward": reward, "shaping_reward": added, "potential": potential}


def report_reset(info: dict[str, Any], potential: float) -> dict[str, Any]:
    """``info`` of one environment's reset."""
    if "shaping_reward" in info:
        potential += info["potential"]
    return {**info, "shaping_reward": 0.0, "potential": potential}


def report_batch(
    infos: dict[str, Any],
    rewards: Float[np.ndarray, "n"],
    added: Float[np.ndarray, "n"],
    potentials: Float[np.ndarray, "n"],
) -> dict[str, Any]:
    """``infos`` of a Gymnasium vector environment, with the same three values for every sub-environment."""
    values = {
        "raw_reward": _reported_inside(infos, "raw_reward", rewards),
        "shaping_reward": added + _reported_inside(infos, "shaping_reward", np.zeros_like(added)),
        "potential": potentials + _reported_inside(infos, "potential", np.zeros_like(added)),
    }
    return infos | values | {f"_{name}": np.ones(len(added), bool) for name in values}


def report_batch_reset(infos: dict[str, Any], potentials: Float[np.ndarray, "n"]) -> dict[str, Any]:
    """``infos`` of a reset: there is no raw reward."""
    none = np.zeros_like(potentials)
    infos = report_batch(infos, none, none, potentials)
    return {name: value for name, value in infos.items() if not name.endswith("raw_reward")}


def _reported_inside(infos: dict[str, Any], name: str, default: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
    """What a shaping inside reported of each sub-environment; after a reset in the same step it is in final_info."""
    values = default.copy()
    for source in (infos, infos.get("final_info") or {}):
        if "shaping_reward" in source and name in source:
            is_reported = source[f"_{name}"]
            values[is_reported] = np.asarray(source[name], np.float64)[is_reported]
    return values
