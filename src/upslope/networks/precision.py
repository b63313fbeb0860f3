"""The precision of a network's convolutions."""

from typing import TypeVar

import equinox as eqx

from upslope.errors import UpslopeError
from upslope.networks.convolution import PRECISIONS
from upslope.networks.dueling import DuelingQ
from upslope.networks.q_network import QNetwork

Network = TypeVar("Network", DuelingQ, QNetwork)


def with_precision(network: Network, precision: str) -> Network:
    """The same network with convolutions (if any) of this precision.

    Raises:
        UpslopeError: the precision is unknown.
    """
    if precision not in PRECISIONS:
        raise UpslopeError(f"There is no precision {precision!r}: choose {', '.join(PRECISIONS)}.")
    return eqx.tree_at(lambda network: network.torso, network, network.torso.with_precision(precision))
