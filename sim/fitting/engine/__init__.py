"""What every fit is built on: windows of logs, sensor noise, parameters, trajectories with their Jacobians, a smoother.

windows            logs cut into windows of equal step count, integrated side by side
wind               the wind that a log measured, by window
parameters, noise  what is estimated, with priors; what the sensors add
model, batched     the vessel model as CasADi expressions, compiled for many windows
motion             trajectories of all windows
jacobian_rows      sensitivities along them, and the rows of the measurement Jacobian
sensors            residuals and measurement derivatives of IMU, compass and position tag
linearise          normal equations of all data at one point
block_tridiagonal  their solution
smoothing          Rauch-Tung-Striebel smoother without a vessel model
split              which part of which log is fitted and which is held out
"""
