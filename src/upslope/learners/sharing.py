"""Sharing one learner's tasks between devices: each device has some of the tasks, and the results are averaged."""

from typing import TypeVar

import jax

Stacked = TypeVar("Stacked")
Numbers = TypeVar("Numbers")


def most_devices(tasks: int, devices: int) -> int:
    """The largest number of devices that can have equal numbers of tasks."""
    return max(share for share in range(1, devices + 1) if tasks % share == 0)


def own_tasks(of_all: Stacked, axis: str | None) -> Stacked:
    """This device's tasks ``[tasks / devices, ...]`` of all ``[tasks, ...]``.

    Args:
        of_all: the same on every device.
        axis: the mesh axis of the devices; None for a device that has all tasks.
    """
    if axis is None:
        return of_all
    devices, place = jax.lax.axis_size(axis), jax.lax.axis_index(axis)

    def own(leaf: jax.Array) -> jax.Array:
        count = leaf.shape[0] // devices
        return jax.lax.dynamic_slice_in_dim(leaf, place * count, count)

    return jax.tree.map(own, of_all)


def mean_of_all(own: Numbers, axis: str | None) -> Numbers:
    """The mean over all devices of each device's numbers. All devices have equally many tasks."""
    return own if axis is None else jax.lax.pmean(own, axis)
