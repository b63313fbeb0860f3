"""XLA's options for programs of different lives: those that run for long, and those that run once."""

#: LLVM's first level: these programs compile in 6 of 10 seconds, and run as fast as at the default level.
QUICK_TO_RUN = {"xla_backend_optimization_level": 1}

#: LLVM's lowest level, for programs that run once: it compiles faster still, and the program runs three times slower.
QUICK_TO_COMPILE = {"xla_backend_optimization_level": 0}

#: No threads within a matrix product: where every core has a device of its own they only get in each other's way.
ONE_THREAD = {"xla_cpu_multi_thread_eigen": False}

#: Devices that share a learner wait for each other: also where a process sleeps for hours, on a laptop that is shut.
PATIENT = {
    "xla_cpu_collective_timeout_seconds": 1_000_000,
    "xla_cpu_collective_call_terminate_timeout_seconds": 1_000_000,
}
