"""Experiments: one folder a published result, one command that prints it beside ours."""
