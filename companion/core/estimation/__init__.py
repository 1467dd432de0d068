"""The rooms of the estimator. `companion.core.estimation.estimator` is the door."""
