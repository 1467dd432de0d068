"""Bytes to messages and back: one codec and one thin transport per device."""
