"""Experiments on CartPoles: Figure 1, studies of its settings, and the prior that ships."""
