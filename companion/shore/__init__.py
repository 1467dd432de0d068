"""The shore's side: subscriber, web console, live Foxglove."""
