"""The one exception that means "the input is at fault": the command line turns it into a message and exit code 2."""

from __future__ import annotations


class InputError(ValueError):
    """What was given cannot be used. The message says what was received, what is allowed and what to do."""
