"""Proof on runs held out, beside a black box as the yardstick."""
