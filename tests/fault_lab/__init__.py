"""A lab of faults: any fault of the stepped world by one line, judged by truth.

trial(seed, "thruster 2 dead from 30")     one mission, one fault or several; a Verdict
draw(seed)                                 a random fault: kind, size, time
"""
