"""Hidden-effect cases: logs of a boat whose simulation is wrong in a known way, and the scoring of who finds it.

Nothing here imports the programs that it judges: own equations, integrator, sensors and pilots. See README.md.
"""
