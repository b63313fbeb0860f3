"""The equations of the paper, one home each, for NumPy and JAX alike."""
