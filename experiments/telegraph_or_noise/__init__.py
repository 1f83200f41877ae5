"""What tells a random telegraph from slow noise of the same spectrum."""
