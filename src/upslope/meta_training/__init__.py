"""Algorithm 1: meta-learning the prior."""
