"""The noise that a diagnosis reckons with: which noises there may be, and how each is made white."""
