"""Learners of others: algorithms written for the comparison, and those of TorchRL and morl-baselines as they are."""
