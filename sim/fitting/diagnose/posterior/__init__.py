"""Maximum a posteriori estimate of trajectories and effects, and its Laplace evidence.

Unknowns are the nodes z (W, L), states and biases at the beginning of each window, and the parameters theta of the
catalogue's effects. Modules: physics with any set of effects, Jacobian columns, normal equations, evidence, noise.
"""
