"""The pre-flight check, pure: what was observed on the wires becomes rows of found, needed, how to mend."""
