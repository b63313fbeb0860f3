"""XLA's options for programs that run for a long time and for programs that run once."""

#: LLVM's optimisation level 1: compilation takes 60% of the time, and programs run as fast as at the default level.
QUICK_TO_RUN = {"xla_backend_optimization_level": 1}

#: LLVM's lowest level, for programs that run once: compilation is even faster, but programs run three times slower.
QUICK_TO_COMPILE = {"xla_backend_optimization_level": 0}

#: No threads within a matrix product: if every core is a separate device, such threads slow each other down.
ONE_THREAD = {"xla_cpu_multi_thread_eigen": False}

#: Devices that share a learner wait for each other, even if a process sleeps for hours, as on a closed laptop.
PATIENT = {
    "xla_cpu_collective_timeout_seconds": 1_000_000,
    "xla_cpu_collective_call_terminate_timeout_seconds": 1_000_000,
}
