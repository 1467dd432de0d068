"""What runs on the boat around the pure core: event loop, recorder, solver thread, interlock, forwarding."""
