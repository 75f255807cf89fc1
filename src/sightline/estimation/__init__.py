"""Banded least squares, autoregressive priors, marginal likelihood: the arithmetic of every smoother."""
