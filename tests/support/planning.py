"""Planning as one program: operations of their own would be compiled one by one for every size of map."""

import equinox as eqx

from upslope.planning import exact

tabulate = eqx.filter_jit(exact.tabulate)
value_iteration = eqx.filter_jit(exact.value_iteration)
