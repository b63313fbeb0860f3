"""Our own environments: stateless and compiled, with the signature of gymnax ≥ 1.0, and as Gymnasium environments."""
