"""`aritra identify`: a vessel's coefficients fitted to logs, judged on held-out data, and written as a vessel file.

structured_fit  maximum a posteriori fit (multiple shooting); horizon: multi-step output error instead
white_noise     sensor noise from the residuals
result          estimates, intervals, undetermined directions, residuals
job             the whole procedure: split, smooth, regress, fit, simulate held-out runs
verdict         which model to believe, and what to drive next
vessel_out      the fitted boat as a vessel file; record, choices, report: everything else that is written
"""
