"""Noise of gyros on a rotating table. One file = one concern: encoder, harmonics of its angle, spectra, pipeline, baselines."""

from __future__ import annotations
