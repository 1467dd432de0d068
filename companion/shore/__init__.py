"""The shore's side: subscriber, web console, Foxglove."""
