"""What is deployed beside the code: boats, sites, missions, run files. Data only."""
