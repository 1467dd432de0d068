"""The pilot: `step(state, inputs, t) -> (state, outputs)`, its mode table and its monitors."""
