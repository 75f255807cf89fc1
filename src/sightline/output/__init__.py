"""The folder of a result: nothing half-written carries a final name, nothing of the user's is lost."""
