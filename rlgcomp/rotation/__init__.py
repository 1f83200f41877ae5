"""Noise of gyros on a rotating table. One file = one concern: the encoder, harmonics of its angle, spectra, the pipeline, baselines."""

from __future__ import annotations
