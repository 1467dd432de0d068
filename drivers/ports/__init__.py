"""Transports: bytes in, bytes out, and a stream that may end. Serial, UDP, TCP, pseudo terminal, memory."""
