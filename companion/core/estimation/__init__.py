"""The rooms of the estimator. `companion.core.estimator` is the door."""
