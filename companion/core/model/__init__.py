"""The 3-DOF manoeuvring model, written once in CasADi for simulator, filter, NMPC and fits."""
