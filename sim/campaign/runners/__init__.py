"""Where cases run: processes of this machine or a Dask cluster; what goes to a worker and what comes back."""
