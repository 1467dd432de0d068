"""Effects on hull, water and thrust, one file each: the one equation that plant, filter, NMPC, fits and diagnosis call.

Each takes numbers, arrays (components first) and CasADi expressions alike.
"""
