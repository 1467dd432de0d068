"""The extended Kalman filter: prediction, gates, start, health. `estimator.Estimator` is what others use."""
