"""How many bits a network's convolutions multiply with."""

from typing import TypeVar

import equinox as eqx

from upslope.errors import UpslopeError
from upslope.networks.convolution import PRECISIONS
from upslope.networks.dueling import DuelingQ
from upslope.networks.q_network import QNetwork

Network = TypeVar("Network", DuelingQ, QNetwork)


def with_precision(network: Network, precision: str) -> Network:
    """The same network, its convolutions (if any) computed with this many bits.

    Raises:
        UpslopeError: an unknown precision.
    """
    if precision not in PRECISIONS:
        raise UpslopeError(f"There is no precision {precision!r}: choose {', '.join(PRECISIONS)}.")
    return eqx.tree_at(lambda network: network.torso, network, network.torso.with_precision(precision))
