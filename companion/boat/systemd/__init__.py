"""The service manager: notifications of readiness, life and status."""
