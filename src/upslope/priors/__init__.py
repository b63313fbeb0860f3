"""Priors: the network, its file, and its NumPy form."""
