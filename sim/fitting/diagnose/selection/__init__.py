"""Which effects the logs ask for, what is left over, and what could be told apart."""
