"""Design of experiments: simulated manoeuvres, the information they carry on each parameter, and what to fly next."""
