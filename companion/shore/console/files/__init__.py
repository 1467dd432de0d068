"""Files for the page: missions read by the boat's own loader, logs of a folder."""
