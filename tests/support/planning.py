"""Planning as one program: separate operations would each be compiled for every size of map."""

import equinox as eqx

from upslope.planning import exact

tabulate = eqx.filter_jit(exact.tabulate)
value_iteration = eqx.filter_jit(exact.value_iteration)
