"""The tests, in rooms that mirror the sources; `support` is what they share."""
